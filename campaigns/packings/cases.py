"""Random cases by seed: parts, their files in all formats, lists, boxes and settings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from campaigns.packings import lists, shapes
from campaigns.packings.mesh_writers import WRITERS
from campaigns.packings.part_files import KINDS, PartFiles
from campaigns.packings.random_parts import Random
from campaigns.packings.shapes import Floats, Shape
from campaigns.packings.truth import MILLIMETRES, TrueBox, TruePart, Truth

ROTATIONS = ("cube", "cube", "fixed", "upright", "yaw-8", "axis-4", "free")

MOST = 14
"""Most items of a case; counts are lowered until there are not more."""

BRICKS, FEWEST_BRICKS, MOST_BRICKS = 0.1, 8, 40
"""Share of the cases whose parts are copies of one block, and their number."""

KEEP_OUTS = 0.15, 0.7
"""Share of the cases in which a volume of the box stays free, and of those with bricks."""


@dataclass(frozen=True, eq=False)
class Case:
    """A case as it is asked of `pack`, and its truth.

    Attributes
    ----------
    sources, boxes, objective : list of str, list of str, str
        The arguments of `pack`.
    settings, reading : dict of str to object
        The arguments of `PackSettings` and `ReadSettings`.
    by_cells : bool
        Whether the search has cells instead of fields, as it has for many different parts.
    of_bricks : bool
        Whether its parts are copies of one block.
    """

    truth: Truth
    sources: list[str]
    boxes: list[str]
    objective: str
    settings: dict[str, Any]
    reading: dict[str, Any]
    by_cells: bool
    of_bricks: bool


def make(seed: int, folder: Path) -> Case:
    """Draw a case, and write its files into a folder."""
    rng = np.random.default_rng(seed)
    later = np.random.default_rng((seed, 1))  # for what was added later: other draws stay as before
    of_bricks = bool(later.random() < BRICKS)
    most = MOST_BRICKS if of_bricks else MOST
    inputs = folder / "inputs"
    (inputs / "parts").mkdir(parents=True, exist_ok=True)
    list_kind = str(rng.choice(list(lists.WRITERS))) if rng.random() < 0.5 else ""
    builder = PartFiles(
        rng,
        inputs / "parts",
        up=None if rng.random() < 0.8 else str(rng.choice(["x", "y", "z"])),
        unit=str(rng.choice(["mm", "mm", "mm", "in", "cm", "m"])),
        split=True if rng.random() < 0.4 else None,
        rotations=str(rng.choice(ROTATIONS)),
    )
    rows = []
    for number in range(1 if of_bricks else int(rng.integers(1, 7))):
        kind = str(rng.choice(list(WRITERS) if of_bricks else KINDS))
        row: dict[str, Any] = {"count": int(rng.integers(1, 6))}
        block = None
        if of_bricks:
            row["count"] = int(later.integers(FEWEST_BRICKS, MOST_BRICKS + 1))
            block = shapes.box(tuple(later.uniform(6, 25, 3)))
        if list_kind:
            row["rotations"] = str(rng.choice(ROTATIONS))
            row["density"] = round(float(rng.uniform(0.5, 8)), 2)
            if rng.random() < 0.3:
                row["unit"] = str(rng.choice(["mm", "cm", "in"]))
        before = len(builder.parts)
        total = sum(part.count for part in builder.parts)
        path = builder.add(number, kind, row, block)
        added = builder.parts[before:]
        if total + sum(part.count for part in added) > most:
            once = sum(len(part.user_from_shape) for part in added)
            fewer = max(1, (most - total) // once)
            builder.parts[before:] = [
                replace(part, count=fewer * len(part.user_from_shape)) for part in added
            ]
            row["count"] = fewer
        rows.append({"file": f"parts/{path.name}", **row})
        if total + items_of(builder.parts[before:]) >= most:
            break
    unread = []
    if rng.random() < 0.15:
        (inputs / "parts" / "broken.stl").write_bytes(b"solid\0" + bytes(100))
        rows.insert(int(rng.integers(len(rows) + 1)), {"file": "parts/broken.stl", "count": 1})
        unread.append("broken.stl")
    if list_kind and rng.random() < 0.1:
        rows.append({"file": "parts/absent.stl", "count": 1})
        unread.append("absent.stl")
    if list_kind and rng.random() < 0.1:
        rows.append({"file": "parts/odd.stl", "count": "many"})
        unread.append("many")
    sources = [f"{inputs / str(row['file'])}={row['count']}" for row in rows]
    if list_kind:
        suffix, write = lists.WRITERS[list_kind]
        write(inputs / f"list{suffix}", rows)
        sources = [str(inputs / f"list{suffix}")]
    return _asked(rng, later, builder, sources, list_kind, unread, of_bricks)


def items_of(parts: Sequence[TruePart]) -> int:
    """Return how many items parts ask for."""
    return sum(part.count for part in parts)


def _asked(
    rng: Random,
    later: Random,
    builder: PartFiles,
    sources: list[str],
    list_kind: str,
    unread: list[str],
    of_bricks: bool,
) -> Case:
    """Draw boxes and settings that the parts can be packed with."""
    unit = str(rng.choice(["mm", "mm", "mm", "cm", "in"]))
    size = MILLIMETRES[unit]
    clearance = 0.0 if rng.random() < 0.3 else round(float(rng.uniform(0.1, 2)) / size, 4)
    walls = 0.0 if rng.random() < 0.5 else round(float(rng.uniform(0, 3)) / size, 4)
    insertable = bool(clearance and rng.random() < 0.15)
    extents = np.array(
        [
            np.ptp(part.shape.moved(place).vertices, axis=0)
            for part in builder.parts
            for place in part.user_from_shape
        ]
    )
    volume = sum(float(np.prod(np.ptp(p.shape.vertices, axis=0))) * p.count for p in builder.parts)
    sides = extents.max(axis=0) * rng.uniform(1.02, 1.6, 3)
    grown = sides * max(1.0, (volume * rng.uniform(0.6, 2.5) / np.prod(sides)) ** (1 / 3))
    own = [math.ceil((side + 2 * walls * size + 0.1) / size * 1000) / 1000 for side in grown]
    text = "x".join(f"{each:.3f}" for each in own)
    objective = str(rng.choice(["volume", "count", "height", "boxes"]))
    boxes, count = [f"{text}{unit}"], 1
    sides = np.array(own) * size
    true = [TrueBox("box", sides, None if objective == "boxes" else 1)]
    if objective in ("volume", "count") and rng.random() < 0.3:
        count = 2
        true = [replace(true[0], count=2)]
    elif objective in ("volume", "count") and rng.random() < 0.2:
        more = "x".join(f"{each * 1.25:.3f}" for each in own)
        boxes = [f"A:{text}{unit}", f"B:{more}{unit}"]
        larger = np.array([float(each) for each in more.split("x")]) * size
        true = [TrueBox("A", true[0].size, 1), TrueBox("B", larger, 1)]
    settings: dict[str, Any] = {
        "clearance": clearance,
        "wall_clearance": walls,
        "boxes": count if count > 1 else None,
        "insertable": insertable,
        "removable": bool(rng.random() < 0.1),
        "separable": bool(rng.random() < 0.1),
    }
    by_cells = bool(rng.random() < 0.3)
    keep_out = None
    if later.random() < KEEP_OUTS[of_bricks]:
        keep_out = _keep_out(later, true[0].size)
        settings["keep_out"] = [str(builder.add_keep_out(keep_out))]
    truth = Truth(
        tuple(builder.parts),
        tuple(true),
        unit,
        clearance * size,
        walls * size,
        insertable,
        tuple(unread),
        list_kind,
        keep_out,
    )
    reading = {"unit": builder.unit, "up": builder.up, "split": builder.split}
    reading |= {"rotations": builder.rotations}
    return Case(truth, sources, boxes, objective, settings, reading, by_cells, of_bricks)


def _keep_out(rng: Random, size: Floats) -> Shape:
    """Draw a prism in a box of this size in millimetres, which may reach through its walls."""
    x, y, z = size * rng.uniform(0.1, 0.35, 3)
    sides = int(rng.integers(3, 8))
    prism = shapes.extruded(shapes.polygon(sides, x / 2, y / 2, rng.uniform(0, 1)), z)
    place = np.eye(4)
    place[:3, 3] = size * rng.uniform(0, 1, 3)
    return prism.moved(place)
