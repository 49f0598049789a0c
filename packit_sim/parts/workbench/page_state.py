"""The state of the workbench's page: a message, the packing, and the files of the last result."""

from __future__ import annotations

import itertools
import shutil
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

from packit_sim.core.errors import ArgumentError
from packit_sim.core.length_units import UNITS_CM, Unit
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.results.check import check
from packit_sim.parts.results.summary import summary
from packit_sim.parts.workbench.scenes import box_scenes

MAX_RESULTS = 20
"""Most results that can be undone."""


_numbers = itertools.count(1)


@dataclass(frozen=True, eq=False)
class ShownPacking:
    """A packing on the page.

    Attributes
    ----------
    locked : tuple of int
        The numbers of the parts, in its one box, that stay where they are.
    folder : Path, optional
        The folder of its files, once it is a result.
    files : dict of str to Path
        The files by their names.
    number : int
        A number that no other packing has.
    """

    packed: PackedParts
    locked: tuple[int, ...] = ()
    folder: Path | None = None
    files: dict[str, Path] = field(default_factory=dict)
    number: int = field(default_factory=lambda: next(_numbers))

    @property
    def key(self) -> str:
        """Text that differs between all that the page shows of packings but the locks."""
        return f"{self.number}:{self.folder}"

    @property
    def can_lock(self) -> bool:
        """True if its parts can be locked: there is one box."""
        return len(self.packed.packings) == 1 and len(self.packed.task.boxes) == 1

    def to_json(self) -> dict[str, Any]:
        """Return what the page shows of it, with the check once its files are written."""
        found = check(self.packed) if self.files else None
        left_out = self.packed.left_out
        return {
            **box_scenes(self.packed),
            "locked": list(self.locked),
            "can lock": self.can_lock,
            "left out": [f"{each.count} x {each.name}: {each.reason}" for each in left_out],
            "notes": list(self.packed.notes),
            "summary": summary(self.packed, found)
            | {"volume": volume_text(self.packed.volume, self.packed.task.unit)},
            "problems": list(found.problems) if found else [],
            "downloads": sorted(self.files),
        }


def volume_text(volume: float, unit: Unit) -> str:
    """Return a volume in the cube of a unit as people write it, with litres from a hundredth on."""
    text = f"{volume:,.0f}" if volume >= 1000 else f"{volume:.4g}"
    litres = volume * UNITS_CM[unit] ** 3 / 1000
    return f"{text} {unit}³" + (f" ({litres:,.3g} l)" if 0.01 <= litres < 1000 else "")


class History:
    """The results of a page, of which one is current.

    Only the current one has files: those of the others are deleted.
    """

    def __init__(self) -> None:
        self._results: list[ShownPacking] = []
        self._current = -1

    @property
    def current(self) -> ShownPacking | None:
        """The current result; None if there is none."""
        return self._results[self._current] if self._results else None

    @property
    def is_first(self) -> bool:
        """True if there is no result before the current one."""
        return self._current <= 0

    @property
    def is_last(self) -> bool:
        """True if there is no result after the current one."""
        return self._current == len(self._results) - 1

    def add(self, result: ShownPacking) -> None:
        """Make a result the current one, instead of all after the one before."""
        self._leave()
        self._results = [*self._results[: self._current + 1], result][-MAX_RESULTS:]
        self._current = len(self._results) - 1

    def change(self, result: ShownPacking) -> None:
        """Replace the current result by the same one with other locks or files."""
        before = self._results[self._current]
        self._results[self._current] = result
        if before.folder is not None and before.folder != result.folder:
            shutil.rmtree(before.folder, ignore_errors=True)

    def move(self, steps: int) -> bool:
        """Make the result so many steps later the current one; return False if there is none."""
        if not 0 <= self._current + steps < len(self._results):
            return False
        self._leave()
        self._current += steps
        return True

    def _leave(self) -> None:
        """Delete the files of the current result."""
        if (now := self.current) is not None and now.folder is not None:
            self.change(replace(now, folder=None, files={}))


class PageState:
    """The state of the page, of which each change is one step.

    Attributes
    ----------
    shown : ShownPacking, optional
        The packing that is shown: the current result, or the best packing of the search that runs.
    order : dict, optional
        The order as it is on the page, in JSON's types.
    """

    def __init__(self) -> None:
        self._changing = threading.Lock()
        self._version = 0
        self._message = ""
        self._faults: dict[str, str] = {}
        self._is_busy = False
        self._history = History()
        self.shown: ShownPacking | None = None
        self.order: dict[str, Any] | None = None

    def note(self, message: str | None = None, shown: ShownPacking | None = None) -> None:
        """Show a message or a packing; without arguments, that something else has changed."""
        with self._changing:
            self._version += 1
            self._message = self._message if message is None else message
            self.shown = shown or self.shown

    def begin(self, message: str = "preparing the parts") -> bool:
        """Begin work on the packing; return False if there is some already."""
        with self._changing:
            was_busy, self._is_busy = self._is_busy, True
            self._version += not was_busy
            if not was_busy:
                self._message, self._faults = message, {}
        return not was_busy

    def end(
        self,
        message: str,
        result: ShownPacking | None = None,
        is_new: bool = True,
        fault: ArgumentError | None = None,
    ) -> None:
        """End the work; without a result, the current one is shown again.

        Parameters
        ----------
        is_new : bool
            Whether the result follows the current one; else it is the same, with its files.
        fault : ArgumentError, optional
            Why it failed, for the field that it is about.
        """
        with self._changing:
            self._version += 1
            self._message, self._is_busy = message, False
            if fault is not None and fault.setting:
                self._faults = {fault.setting: str(fault)}
            if result is not None:
                is_first = self._history.current is None
                (self._history.add if is_new or is_first else self._history.change)(result)
            self.shown = self._history.current or self.shown

    def move(self, steps: int) -> bool:
        """Show the result so many steps later, not during other work; return whether it is done."""
        with self._changing:
            if self._is_busy or not self._history.move(steps):
                return False
            self._version += 1
            self._message = ""
            self.shown = self._history.current
        return True

    def result(self, key: str) -> ShownPacking:
        """Return the current result, which has a key; raise ArgumentError if there is none."""
        with self._changing:
            now = self._history.current
            if self._is_busy or now is None or now.key != key:
                raise ArgumentError("the packing has changed meanwhile: look at it again")
            return now

    def lock(self, part: int, is_locked: bool) -> None:
        """Lock a part of the result that is shown, or unlock it.

        Raises
        ------
        ArgumentError
            If the packing has no such part, is in several boxes, or is not a result.
        """
        with self._changing:
            now = self._history.current
            if self._is_busy or now is None or not now.can_lock:
                raise ArgumentError("there is no result in one box whose parts can be locked")
            if not 0 <= part < now.packed.count:
                raise ArgumentError(f"there is no part {part} to lock")
            locked = set(now.locked) - {part} | ({part} if is_locked else set())
            self._history.change(replace(now, locked=tuple(sorted(locked))))
            self.shown = self._history.current
            self._version += 1

    def to_json(
        self,
        seen: str | None,
        number: str | None,
        files: Callable[[], list[dict[str, Any]]],
    ) -> dict[str, Any]:
        """Return what the page shows; only the first fields if it has seen this version.

        Parameters
        ----------
        seen : str, optional
            The version that the page has seen.
        number : str, optional
            The key of the packing that it shows.
        files : callable
            Returns what the page shows of the files. It is called after the version is known: a
            file that arrives meanwhile is in the list, or the next version has it.

        Returns
        -------
        dict[str, Any]
            The state, with the packing if the page shows another one.
        """
        with self._changing:
            version, shown = self._version, self.shown
            state: dict[str, Any] = {
                "version": version,
                "message": self._message,
                "faults": self._faults,
                "busy": self._is_busy,
                "undo": not (self._is_busy or self._history.is_first),
                "redo": not (self._is_busy or self._history.is_last),
            }
        if seen == "-1":
            state["order"] = self.order
        if seen != str(version):
            state["files"] = files()
            if shown is not None:
                state["packing"], state["locked"] = shown.key, list(shown.locked)
                if number != shown.key:
                    state["result"] = shown.to_json()
        return state

    def opened(self, name: str) -> BinaryIO | None:
        """Open a file of the current result, readable also when the next one replaces it."""
        with self._changing:
            now = self._history.current
            file = None if now is None else now.files.get(name)
            return None if file is None else file.open("rb")

    def all_opened(self) -> dict[str, BinaryIO]:
        """Open all files of the current result."""
        with self._changing:
            now = self._history.current
            return {} if now is None else {n: f.open("rb") for n, f in sorted(now.files.items())}
