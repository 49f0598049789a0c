"""Decides whether a result is right, by the meshes of the truth and the poses of the record.

It imports numpy, scipy, manifold3d and lib3mf, and nothing of PackIt-Sim or trimesh.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from campaigns.packings import solids
from campaigns.packings.items import VISIBLE, Item, identified
from campaigns.packings.mesh_writers import SINGLE
from campaigns.packings.results_files import read_3mf, read_stl
from campaigns.packings.shapes import Floats, Shape
from campaigns.packings.truth import MILLIMETRES, Problem, TruePart, Truth


def check(truth: Truth, folder: Path) -> list[Problem]:
    """Return what is wrong in the folder that `packit pack` wrote."""
    record = json.loads((folder / "packing.json").read_text())
    if record["unit"] != truth.unit:
        return [Problem(f"the unit is {record['unit']}, not {truth.unit}")]
    return list(_problems(truth, record, folder))


def _problems(truth: Truth, record: dict[str, Any], folder: Path) -> Iterator[Problem]:
    unit = MILLIMETRES[truth.unit]
    yield from _boxes(truth, record, unit)
    owners: dict[str, list[TruePart]] = {}
    for entry in record["parts"]:
        owners[entry["name"]] = _owners(truth, entry)
        if not owners[entry["name"]]:
            yield Problem(f"nobody asked for part {entry['name']!r} of {entry['file']}")
    items: list[Item] = []
    for number, _ in enumerate(record["boxes"]):
        stem = "packing" if len(record["boxes"]) == 1 else f"packing-{number + 1}"
        bodies, warnings = read_3mf(folder / f"{stem}.3mf")
        for warning, times in Counter(warnings).items():
            yield Problem(f"{stem}.3mf: {warning} ({times} times)")
        entries = [each for each in record["items"] if each["box"] == number]
        found = yield from identified(entries, owners, bodies, number, unit)
        items += found
        yield from _stl([each.solid for each in found], folder / f"{stem}.stl", len(bodies))
        size = np.array(record["boxes"][number]) * unit
        yield from solids_problems(truth, found, size)
    yield from _counts(truth, record, owners)
    yield from _masses(record, owners, unit)
    yield from _summary(record, items, unit)


def _boxes(truth: Truth, record: dict[str, Any], unit: float) -> Iterator[Problem]:
    """Check the boxes and the distances that the record names."""
    for name, value in (("clearance", truth.clearance), ("wall clearance", truth.wall_clearance)):
        if abs(record[name] * unit - value) > 1e-9:
            yield Problem(f"{name} {record[name]} {truth.unit}, not {value / unit}")
    used = Counter(record["box names"])
    for name, size in zip(record["box names"], record["boxes"], strict=True):
        asked = [each for each in truth.boxes if each.name == name]
        if not asked or not np.allclose(np.array(size) * unit, asked[0].size, rtol=1e-9):
            yield Problem(f"nobody asked for a box {name!r} of {size} {truth.unit}")
        elif asked[0].count is not None and used[name] > asked[0].count:
            yield Problem(f"{used[name]} boxes {name!r}, of {asked[0].count}")
    for text in truth.unread:
        if not any(text in each["source"] + each["reason"] for each in record["files not read"]):
            yield Problem(f"{text} is not among the files that were not read")


def _owners(truth: Truth, entry: dict[str, Any]) -> list[TruePart]:
    """Return the true parts that an entry of the record's parts may be."""
    file = Path(entry["file"] or "").name
    found = [part for part in truth.parts if file.startswith(part.file)]
    named = [part for part in found if part.token and part.token in entry["name"]]
    return named or [part for part in found if not part.token]


def solids_problems(truth: Truth, items: Sequence[Item], size: Floats) -> Iterator[Problem]:
    """Yield what is wrong with the places of the items in a box of this size in millimetres."""
    rules = solids.Rules(truth.clearance, truth.wall_clearance, tuple(size))
    bodies = [item.solid for item in items]
    free = truth.keep_out and _as_read(truth.keep_out)
    for item, body in zip(items, bodies, strict=True):
        depth = rules.depth_in_walls(body)
        if depth > 0:
            yield Problem(f"{item.part.file} is {depth:.4g} mm in the walls", (item.part.kind,))
        for text in rules.between(free, body) if free else ():
            yield Problem(f"{item.part.file} and the keep-out {text}", (item.part.kind,))
    for i, one in enumerate(bodies):
        for j in range(i):
            kinds = tuple(dict.fromkeys((items[j].part.kind, items[i].part.kind)))
            for text in rules.between(bodies[j], one):
                yield Problem(f"{items[i].part.file} and {items[j].part.file} {text}", kinds)
            if truth.insertable and rules.is_below(one, bodies[j]):
                text = (
                    f"{items[i].part.file} can't be put in straight down after {items[j].part.file}"
                )
                yield Problem(text, kinds)


def _as_read(keep_out: Shape) -> solids.Solid:
    """Return a keep-out, with the rounding of its file."""
    rounding = SINGLE * float(np.abs(keep_out.vertices).max())
    return solids.Solid(keep_out.vertices, keep_out.triangles, rounding)


def _stl(bodies: Sequence[solids.Solid], path: Path, count: int) -> Iterator[Problem]:
    """Check that an STL file has the bodies of a box."""
    if len(bodies) != count or not bodies:
        return  # some are not identified, which is a problem already
    corners = read_stl(path)
    shown = corners.reshape(-1, 3)
    true = np.vstack([body.corners.reshape(-1, 3) for body in bodies])
    far = max(cKDTree(shown).query(true)[0].max(), cKDTree(true).query(shown)[0].max())
    near = VISIBLE + 2 * max(body.rounding for body in bodies)
    own = sum(solids.area(body.corners) for body in bodies)
    if far > near or abs(solids.area(corners) / own - 1) > 0.01:
        yield Problem(f"{path.name} has other bodies: {far:.3g} mm away")


def _counts(
    truth: Truth, record: dict[str, Any], owners: dict[str, list[TruePart]]
) -> Iterator[Problem]:
    """Check that every part is packed or named, and none is packed too often."""
    groups: dict[tuple[str, str], list[TruePart]] = {}
    for part in truth.parts:
        groups.setdefault((part.file, part.token), []).append(part)
    packed, left = Counter(each["name"] for each in record["items"]), Counter[str]()
    for each in record["left out"]:
        left[each["name"]] += each["count"]
    for (file, token), parts in groups.items():
        kinds = tuple(dict.fromkeys(part.kind for part in parts))
        unread = [each for each in record["files not read"] if file in each["source"]]
        if unread:
            yield Problem(f"{file} is not read: {unread[0]['reason']}", kinds, is_unread=True)
            continue
        names = [name for name, own in owners.items() if parts[0] in own]
        asked = sum(part.count for part in parts)
        told = sum(each["count"] for each in record["parts"] if each["name"] in names)
        done = sum(packed[name] + left[name] for name in names)
        if told != asked or done != asked:
            text = f"{told} asked for and {done} packed or left out, of {asked}"
            yield Problem(f"{file} {token}: {text}", kinds)


def _masses(
    record: dict[str, Any], owners: dict[str, list[TruePart]], unit: float
) -> Iterator[Problem]:
    """Check the volume and the mass of one of each part."""
    for entry in record["parts"]:
        own = owners[entry["name"]]
        if not own:
            continue
        kinds = (own[0].kind,)
        volume = entry["volume"] * unit**3
        part = min(own, key=lambda each: abs(each.shape.volume - volume))
        error = volume / part.shape.volume - 1
        if not abs(error) < volume_error(part):
            yield Problem(f"{entry['name']}: its volume is wrong by {error:.2%}", kinds)
        if part.density is None:
            if entry["mass"] is not None:
                yield Problem(f"{entry['name']}: {entry['mass']} g, but nobody said so", kinds)
            continue
        mass = part.density * part.shape.volume / 1000
        if entry["mass"] is None or not abs(entry["mass"] / mass - 1) < volume_error(part):
            yield Problem(f"{entry['name']}: {entry['mass']} g, not {mass:.6g}", kinds)


def volume_error(part: TruePart) -> float:
    """Return the largest relative error of a volume that is right."""
    surface = solids.area(part.shape.vertices[part.shape.triangles])
    return 1e-5 + 2 * part.rounding * surface / part.shape.volume


def _summary(record: dict[str, Any], items: Sequence[Item], unit: float) -> Iterator[Problem]:
    """Check the numbers of the summary, if all items are identified."""
    if len(items) != len(record["items"]) or not items:
        return
    error = max((volume_error(item.part) for item in items), default=0.0)
    volume = sum(item.part.shape.volume for item in items) / unit**3
    height = max(float(item.solid.corners[..., 2].max()) for item in items) / unit
    for name, true, slack in (
        ("volume", volume, error),
        ("height", height, (VISIBLE + 2 * max(i.part.rounding for i in items)) / unit / height),
    ):
        told = float(record["summary"][name].split()[0])
        if not abs(told / true - 1) < slack + 1e-4:
            yield Problem(f"the {name} is said to be {told}, not {true:.6g} {name}")
    if not record["summary"]["check"].startswith("no problems"):
        yield Problem(f"the product's own check: {record['summary']['check']}")
