"""`packit containers`: the containers that have a name."""

from __future__ import annotations

from packit_sim.core.lazy_imports import lazy_imports

with lazy_imports():
    from packit_sim.cli import terminal
    from packit_sim.core import configuration
    from packit_sim.parts.reading import named_containers


def containers_command() -> None:
    """List the containers with a name, which `packit pack --container NAME` takes.

    Example: packit containers
    """
    for each in named_containers.named_containers().values():
        mass, parts = each.limits.max_mass, each.limits.max_parts
        most = [f"{mass / 1000:g} kg"] if mass is not None else []
        most += [f"{parts} parts"] if parts is not None else []
        limits = ", ".join(most)
        _print(f"{each.name:<23} {each.kind:<11} {each.size:<23} {limits:<9} {each.source}")
    own = configuration.config_folder() / named_containers.FILE
    _print(f"Your own: {own}")


def _print(line: str) -> None:
    terminal.console.print(line, markup=False, highlight=False, soft_wrap=True)
