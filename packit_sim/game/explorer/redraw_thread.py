"""A thread that redraws the page when it is woken."""

from __future__ import annotations

import threading
from collections.abc import Callable

from packit_sim.core.plain_text import plain_logger

_log = plain_logger(__name__)


class RedrawThread:
    """A thread that calls a function once for all wake-ups since the last call.

    Parameters
    ----------
    work : Callable[[], float | None]
        Returns the seconds after which it is to be called again, or None. An exception is logged,
        and the thread continues.
    """

    def __init__(self, work: Callable[[], float | None]) -> None:
        self._work = work
        self._changed = threading.Condition()
        self._requested = 1
        self._done = 0
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="packit view", daemon=True)

    def start(self) -> None:
        """Start the thread, which calls the function immediately."""
        self._thread.start()

    def wake(self) -> None:
        """Request a call, without waiting for it."""
        with self._changed:
            self._requested += 1
            self._changed.notify_all()

    def wait(self, timeout: float = 60.0) -> None:
        """Wait for all requested calls to end; raise TimeoutError after `timeout` seconds."""
        with self._changed:
            requested = self._requested
            if not self._changed.wait_for(lambda: self._done >= requested or self._closed, timeout):
                raise TimeoutError(f"the page was not drawn within {timeout:g} s")

    def close(self) -> None:
        """End the thread after the call that is running."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        wait: float | None = None
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._requested > self._done or self._closed, wait)
                if self._closed:
                    return
                requested = self._requested
            try:
                wait = self._work()
            except Exception:
                wait = None
                _log.exception("the page could not be drawn")
            with self._changed:
                self._done = max(self._done, requested)
                self._changed.notify_all()
