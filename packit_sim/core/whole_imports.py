"""Imports in one piece: neither signals nor garbage collections interrupt them."""

import gc
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

from packit_sim.core.signals import SIGNALS, end_process

_MANY = 100
"""Modules whose objects are worth excluding from later garbage collections."""

_running: list[ModuleType] = []
"""The module that the main thread executes, of those that do so for no other import."""


class _Uninterrupted(MetaPathFinder):
    """Finds modules as usual; as one is executed, signals wait that would be KeyboardInterrupt."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target)
        loader = None if spec is None else spec.loader
        if loader is not None:
            vars(loader)["exec_module"] = _uninterrupted(loader.exec_module)
        return spec


def let_imports_end() -> None:
    """Let KeyboardInterrupt wait for the end of an import, which might show another error instead.

    Compiled modules, and those that try an import, take it for a failure. What an import creates
    stays, so garbage is not collected meanwhile, nor looked for later in what many modules created:
    that would be a sixth of the time of the imports of `packit pack`.
    """
    sys.meta_path.insert(0, _Uninterrupted())


def _uninterrupted(execute: Callable[[ModuleType], None]) -> Callable[[ModuleType], None]:
    def executed(module: ModuleType) -> None:
        if _running or threading.current_thread() is not threading.main_thread():
            return execute(module)
        with _signals_waiting(), _garbage_waiting():
            _running.append(module)
            try:
                execute(module)
            finally:
                _running.clear()

    return executed


@contextmanager
def _signals_waiting() -> Iterator[None]:
    """Let signals that would be KeyboardInterrupt wait for the end of the block."""
    found = {number: signal.getsignal(number) for number in SIGNALS}
    handlers = {
        number: to for number, to in found.items() if callable(to) and to is not end_process
    }
    waiting: list[int] = []
    for number in handlers:
        signal.signal(number, lambda number, frame: waiting.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in waiting:
            signal.raise_signal(number)


@contextmanager
def _garbage_waiting() -> Iterator[None]:
    """Collect no garbage in the block, nor later what many modules created in it."""
    before, was_on = len(sys.modules), gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if len(sys.modules) - before >= _MANY:
            gc.freeze()
        if was_on:
            gc.enable()
