"""Imports that signals do not interrupt."""

import signal
import sys
import threading
from collections.abc import Callable, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

from packit_sim.core.signals import SIGNALS, end_process


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

    Compiled modules, and those that try an import, take it for a failure.
    """
    sys.meta_path.insert(0, _Uninterrupted())


def _uninterrupted(execute: Callable[[ModuleType], None]) -> Callable[[ModuleType], None]:
    def executed(module: ModuleType) -> None:
        if threading.current_thread() is not threading.main_thread():
            return execute(module)
        found = {number: signal.getsignal(number) for number in SIGNALS}
        handlers = {
            number: to for number, to in found.items() if callable(to) and to is not end_process
        }
        waiting: list[int] = []
        for number in handlers:
            signal.signal(number, lambda number, frame: waiting.append(number))
        try:
            execute(module)
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
            for number in waiting:
                signal.raise_signal(number)

    return executed
