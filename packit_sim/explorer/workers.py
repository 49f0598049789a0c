"""A thread that does again what has to be done, as often as it is woken, and no more."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

_log = logging.getLogger(__name__)


class Worker:
    """Does the work once for all wakings that came before, in a thread of its own.

    work: returns the seconds after which it wants to be done again, or None. Where it raises, that
    is logged, and the worker goes on.
    """

    def __init__(self, work: Callable[[], float | None]) -> None:
        self._work = work
        self._changed = threading.Condition()
        self._asked = 1
        self._done = 0
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="packit view", daemon=True)

    def start(self) -> None:
        """Begins, with the work once."""
        self._thread.start()

    def wake(self) -> None:
        """Asks for the work; returns at once."""
        with self._changed:
            self._asked += 1
            self._changed.notify_all()

    def settle(self, timeout: float = 60.0) -> None:
        """Waits until all is done that was asked for. Raises TimeoutError where it takes longer."""
        with self._changed:
            asked = self._asked
            if not self._changed.wait_for(lambda: self._done >= asked or self._closed, timeout):
                raise TimeoutError(f"the page was not drawn within {timeout:g} s")

    def close(self) -> None:
        """Ends the thread, after what it is at work on."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        wait: float | None = None
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._asked > self._done or self._closed, wait)
                if self._closed:
                    return
                asked = self._asked
            try:
                wait = self._work()
            except Exception:
                wait = None
                _log.exception("the page could not be drawn")
            with self._changed:
                self._done = max(self._done, asked)
                self._changed.notify_all()
