"""The command `packit`, before anything of it is imported."""

import signal


def main() -> None:
    """Run `packit`; Ctrl-C shows no traceback, though imports have yet to begin."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from packit_sim.__main__ import main as run

    run()
