"""A bar of the kernels that are compiled when commands are used for the first time."""

from __future__ import annotations

import sys
from typing import Any

from rich.progress import TextColumn
from rich.text import Text

_OURS = ("packit_sim", "packit_agents")

_CELLS = 10
"""Characters of the bar."""


class NoteColumn(TextColumn):
    """The note of a task, or while kernels are compiled, how many of the loaded ones are ready."""

    def __init__(self) -> None:
        super().__init__("{task.fields[note]}", markup=False)
        self._compiling: Any = None

    def render(self, task: Any) -> Text:
        if self._compiling is None and "numba.core.event" in sys.modules:
            self._compiling = _listener()
        if self._compiling is None or not self._compiling.open:
            return super().render(task)
        kernels = _loaded()
        ready = sum(bool(one.signatures) for one in kernels)
        full = _CELLS * ready // max(len(kernels), 1)
        bar = "━" * full + "╌" * (_CELLS - full)
        return Text(f"compiling, once: {bar} {ready} of at most {len(kernels)}")


def _listener() -> Any:
    """Register a listener, whose `open` is the number of kernels that are being compiled."""
    from numba.core import event

    class Compiling(event.Listener):  # type: ignore[misc] # numba's own hints are not read
        open = 0

        def on_start(self, event: Any) -> None:
            self.open += 1

        def on_end(self, event: Any) -> None:
            self.open -= 1

    listener = Compiling()
    event.register("numba:compile", listener)
    return listener


def _loaded() -> list[Any]:
    """List the kernels of the modules that are loaded."""
    from numba.core.dispatcher import Dispatcher

    modules = [one for name, one in list(sys.modules.items()) if name.startswith(_OURS)]
    values = (value for one in modules for value in list(vars(one).values()))
    return list({id(value): value for value in values if isinstance(value, Dispatcher)}.values())
