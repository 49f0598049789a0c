"""Which part of the truth each item of a result is, and where."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from campaigns.packings import solids
from campaigns.packings.random_parts import QUARTERS
from campaigns.packings.results_files import Body
from campaigns.packings.shapes import Floats
from campaigns.packings.truth import Problem, TruePart

VISIBLE = 0.002
"""Millimetres by which a body of an exported file may be elsewhere than in the record."""


@dataclass(frozen=True, eq=False)
class Item:
    """A part of the truth at the pose of the record."""

    part: TruePart
    box: int
    box_from_shape: Floats

    @property
    def solid(self) -> solids.Solid:
        """Its solid in the box."""
        shape = self.part.shape.moved(self.box_from_shape)
        return solids.Solid(shape.vertices, shape.triangles, self.part.rounding)


def identified(
    entries: Sequence[dict[str, Any]],
    owners: dict[str, list[TruePart]],
    bodies: Sequence[Body],
    box: int,
    unit: float,
) -> Generator[Problem, None, list[Item]]:
    """Find each item's body in the 3MF file; yield problems, and return the items."""
    left, found = list(bodies), []
    if len(entries) != len(bodies):
        yield Problem(f"{len(bodies)} bodies in the 3MF file, {len(entries)} items in the record")
    for entry in entries:
        parts = owners.get(entry["name"], [])
        kinds = tuple(dict.fromkeys(part.kind for part in parts))
        pose = np.array(entry["pose"], dtype=float)
        pose[:3] *= unit
        scale = float(np.cbrt(np.linalg.det(pose[:3, :3])))
        turn = pose[:3, :3] / scale
        if scale <= 0 or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6):
            yield Problem(f"{entry['name']}: its pose is no rotation with one scale", kinds)
            continue
        matches = [
            (Item(part, box, motion), body, _is_allowed(part, motion))
            for part in parts
            for motion in _motions(part, pose, scale)
            for body in left
            if _is_same(part, motion, body)
        ]
        if not matches:
            yield Problem(f"{entry['name']}: no body of the 3MF file is the true part there", kinds)
            continue
        item, body, is_allowed = max(matches, key=lambda match: match[2])
        left.remove(body)
        found.append(item)
        if not is_allowed:
            yield Problem(f"{entry['name']}: rotated against {item.part.rotations}", kinds)
        own_name = entry["name"].rpartition("/")[2]
        if own_name not in body.name:
            yield Problem(f"{entry['name']}: its body is called {body.name!r}", kinds)
    return found


def _motions(part: TruePart, pose: Floats, scale: float) -> Iterator[Floats]:
    """Yield where the pose of a record may put a shape.

    The pose is from the coordinates of a mesh file, whose unit its scale shows. They are those of
    the original file with its copies, or of one mesh alone, after or before its z axis points up.
    The body of the 3MF file, which has coordinates of the box alone, decides.
    """
    rigid = pose.copy()
    rigid[:3, :3] /= scale
    for place in (*part.user_from_shape, np.eye(4)):
        for up in (part.up, np.eye(3)):
            turned = np.eye(4)
            turned[:3, :3] = up.T
            yield rigid @ turned @ place


def _is_same(part: TruePart, motion: Floats, body: Body) -> bool:
    """Return whether a body has the corners and the surface of a part at a place."""
    near = VISIBLE + 2 * part.rounding
    shape = part.shape.moved(motion)
    corners = shape.vertices[np.unique(shape.triangles)]
    used = body.vertices[np.unique(body.triangles)]
    ends = (corners.min(axis=0) - used.min(axis=0), corners.max(axis=0) - used.max(axis=0))
    if np.abs(ends).max() > near:
        return False
    there, back = cKDTree(used).query(corners)[0], cKDTree(corners).query(used)[0]
    own = solids.area(shape.vertices[shape.triangles])
    area = solids.area(body.vertices[body.triangles])
    return max(there.max(), back.max()) <= near and abs(area / own - 1) < 0.01


def _is_allowed(part: TruePart, box_from_shape: Floats) -> bool:
    """Return whether a rotation is one of the part's set, from the orientation in its file."""
    turns = [box_from_shape[:3, :3] @ place[:3, :3].T for place in part.user_from_shape]
    return any(_is_in_set(part.rotations, turn) for turn in turns)


def _is_in_set(name: str, turn: Floats) -> bool:
    if name == "free":
        return True
    if name == "cube":
        return bool((np.abs(QUARTERS - turn).max(axis=(1, 2)) < 1e-6).any())
    if name == "fixed":
        return bool(np.abs(turn - np.eye(3)).max() < 1e-6)
    kind, steps = ("yaw", 4) if name == "upright" else (name[:-2], int(name[-1]))
    for axis in np.eye(3)[2:] if kind == "yaw" else np.eye(3):
        if np.abs(turn @ axis - axis).max() < 1e-6:
            angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)) * steps / (2 * np.pi)
            if abs(angle - round(angle)) < 1e-4:
                return True
    return False
