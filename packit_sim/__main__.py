"""`packit`, and `python -m packit_sim`."""

from packit_sim.core.signals import end_at_once


def main() -> None:
    """Run `packit`, which signals can end while it is still importing."""
    end_at_once()
    from packit_sim.core.whole_imports import let_imports_end

    let_imports_end()
    from packit_sim.cli.app import main as run

    run()


if __name__ == "__main__":
    main()
