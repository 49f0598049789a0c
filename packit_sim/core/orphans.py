"""Worker processes that end with the process that started them, also if that was killed."""

import os
import threading
import time

CHECK_SECONDS = 0.5
"""Time between two looks at the parent."""


def end_with(parent: int) -> None:
    """Let this process end soon after its parent; for the initializer of a worker.

    Parameters
    ----------
    parent : int
        The id of the process that started this one.
    """
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:  # that of an orphan is another process
        time.sleep(CHECK_SECONDS)
    os._exit(1)
