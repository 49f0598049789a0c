"""The command `packit`, before anything of it is imported.

Python's module `signal` takes milliseconds to import, in which Ctrl-C may come.
"""

import _signal as signal  # type: ignore[import-not-found]


def main() -> None:
    """Run `packit`; Ctrl-C shows no traceback, though imports have yet to begin."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from packit_sim.__main__ import main as run

    run()
