"""The state of the workbench's page: a message, the packing, and the files of the last result."""

from __future__ import annotations

import shutil
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.reading.part import Part
from packit_sim.parts.results.check import check
from packit_sim.parts.results.page import add_box
from packit_sim.parts.results.summary import summary
from packit_sim.web.page_models import Models


@dataclass(frozen=True)
class LockedPart:
    """A part that stays where it was: its name before it was fixed, and the part that is fixed."""

    name: str
    part: Part


@dataclass(frozen=True)
class ShownPacking:
    """A packing on the page.

    Attributes
    ----------
    locked : tuple of LockedPart
        The parts that were locked when the search began.
    folder : Path, optional
        The folder of its files, once it is a result.
    files : dict of str to Path
        The files by their names.
    """

    packed: PackedParts
    locked: tuple[LockedPart, ...]
    folder: Path | None = None
    files: dict[str, Path] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return what the page shows of it, with numbers once its files are checked."""
        models = Models()
        boxes = []
        for contents in self.packed.contents:
            add_box(models, contents)
            names = [self.packed.part(one).part.name for one in contents.placements]
            boxes.append({"name": contents.container.name, "parts": names})
        found = check(self.packed) if self.files else None
        left_out = self.packed.left_out
        return {
            "models": models.to_json(),
            "boxes": boxes,
            "locked": len(self.locked),
            "left out": [f"{each.count} x {each.name}: {each.reason}" for each in left_out],
            "notes": list(self.packed.notes),
            "summary": summary(self.packed, found) if found else {},
            "problems": list(found.problems) if found else [],
            "downloads": sorted(self.files),
        }


class PageState:
    """The state of the page, of which each change is one step.

    Attributes
    ----------
    shown : ShownPacking, optional
        The packing that is shown: the last result, or the best packing of the search that runs.
    """

    def __init__(self) -> None:
        self._changing = threading.Lock()
        self._version = 0
        self._message = ""
        self._is_busy = False
        self._result: ShownPacking | None = None
        self.shown: ShownPacking | None = None

    def note(self, message: str | None = None, shown: ShownPacking | None = None) -> None:
        """Show a message or a packing; without arguments, that something else has changed."""
        with self._changing:
            self._version += 1
            self._message = self._message if message is None else message
            self.shown = shown or self.shown

    def begin(self) -> bool:
        """Begin a search; return False if one is running."""
        with self._changing:
            was_busy, self._is_busy = self._is_busy, True
            self._version += not was_busy
            self._message = self._message if was_busy else "preparing the parts"
        return not was_busy

    def end(self, message: str, result: ShownPacking | None = None) -> None:
        """End the search, with its result; without one, the last result is shown again."""
        with self._changing:
            self._version += 1
            self._message, self._is_busy = message, False
            before, self._result = self._result, result or self._result
            self.shown = self._result or self.shown
        if result is not None and before is not None and before.folder is not None:
            shutil.rmtree(before.folder, ignore_errors=True)

    def to_json(self, seen: str | None, files: list[dict[str, Any]]) -> dict[str, Any]:
        """Return what the page shows; only the first fields if it has seen this version."""
        with self._changing:
            version, shown = self._version, self.shown
            state = {"version": version, "message": self._message, "busy": self._is_busy}
        if seen != str(version):
            state["files"] = files
            if shown is not None:
                state["result"] = shown.to_json()
        return state

    def opened(self, name: str) -> BinaryIO | None:
        """Open a file of the last result, which stays readable when the next one replaces it."""
        with self._changing:
            file = None if self._result is None else self._result.files.get(name)
            return None if file is None else file.open("rb")
