"""The check of packed parts by their original files, independent of the search.

trimesh reads the files' content again, and `reread_3mf.py` that in 3MF. The collision meshes of the
search play no role, and neither does the nester's own check.
"""

from __future__ import annotations

import importlib.util
import io
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import trimesh

from packit_sim.core.caches import bounded_cache, cached_property
from packit_sim.core.errors import reason
from packit_sim.core.memory import release_memory
from packit_sim.core.plain_text import plain_line
from packit_sim.core.progress import Progress, unseen
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.parts import by_part, part_numbers
from packit_sim.geometry.winding import winding_numbers
from packit_sim.libraries.obj_faces import simple_faces
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.packings import checked_items
from packit_sim.parts.packings.containers import Container
from packit_sim.parts.packings.cylinders import CylinderContainer
from packit_sim.parts.packings.distances import WallClearance
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.prepared import PreparedPart
from packit_sim.parts.results.reread_3mf import read_3mf
from packit_sim.parts.results.reread_scenes import SUFFIXES as SCENES
from packit_sim.parts.results.reread_scenes import read_scene
from packit_sim.placement import LooseMesh

SIZE = 1e4
"""The longest side of a box in the numbers that FCL gets: in small numbers it is not accurate."""

SAMPLES = 9
"""Points of a connected part of a surface that vote on whether it is inside another part."""

_MESHES = 256
"""Meshes for FCL that are kept: one with 2,000 triangles has a megabyte."""

_ROUNDING = 1e-7
"""Rounding of distances, relative to the box's longest side."""


@dataclass(frozen=True)
class Check:
    """The result of a check of packed parts by their original files.

    Attributes
    ----------
    problems : tuple of str
        A sentence for each problem.
    distance : float, optional
        The smallest distance of two parts in one box, not below 0; None for fewer than two parts.
    how : str
        What the check is based on.
    """

    problems: tuple[str, ...]
    distance: float | None
    how: str


_known: WeakKeyDictionary[PackedParts, Check] = WeakKeyDictionary()
"""Results, kept as long as the packed parts: a check takes long."""


def check(packed: PackedParts, progress: Progress = unseen) -> Check:
    """Check the original files of packed parts at their poses, independently of the search.

    Parameters
    ----------
    progress : callable, optional
        Called with the number of parts that are read and compared.

    Returns
    -------
    Check
        Parts that are outside their box or too close to its walls, that overlap, or that are nearer
        to each other than the clearance; and the smallest distance. A check that fails, as of a
        file that is gone, is a problem.

    Notes
    -----
    trimesh reads the files again, and `reread_3mf.py` those in 3MF, once for each `PackedParts`.
    FCL computes distances of their triangles, and manifold3d, where it is installed, the volumes
    that closed parts share.
    """
    if packed not in _known:
        try:
            found = [_box(packed, number, progress) for number in range(len(packed.packings))]
        except Exception as error:
            found = [([f"the check failed: {reason(error)}"], None)]
        how = "files read again, distances by FCL"
        if _has_manifold():
            how += ", shared volumes by manifold3d"
        problems = tuple(sentence for own, _ in found for sentence in own)
        distances = [distance for _, distance in found if distance is not None]
        _known[packed] = Check(problems, min(distances, default=None), how)
        _loose.clear()
        release_memory()
    return _known[packed]


def _box(packed: PackedParts, number: int, progress: Progress) -> tuple[list[str], float | None]:
    """Return the problems in a box, and the smallest distance of two parts."""
    settings, packing = packed.task.settings, packed.packings[number]
    container = packing.container
    problems: list[str] = []
    originals: dict[int, _Original | None] = {}
    placed = []
    total = len(packing.placements)
    for n, one in enumerate(packing.placements):
        progress("checking the files", n, total)
        part = packed.part(one)
        if one.type not in originals:
            try:
                originals[one.type] = _Original(part, container.longest)
            except Exception as error:  # of any reader; or the file has changed meanwhile
                originals[one.type] = None
                problems.append(f"{part.part.name} can't be read again: {plain_line(str(error))}")
        original = originals[one.type]
        if original is not None:
            box_from_file = one.pose @ part.part.user_from_file
            placed.append(_Placed(original, box_from_file, f"part {n} of box {number + 1}"))
    outline = packed.task.outlines.get(container.name)
    wall = None if outline is None else _wall(outline, container.longest)
    for each in placed:
        problems += _outside(each, container, wall, packed.task.walls)
    first, second = np.triu_indices(len(placed), 1)
    required = (settings.clearance, _stretch(settings))
    found, distance = _between(placed, first, second, *required, progress)
    around = [
        *(_in_place(each, container.longest, "kept free") for each in packed.task.keep_out),
        *(_in_place(each, container.longest, "fixed") for each in packed.task.fixed),
    ]
    outer, inner = np.indices((len(around), len(placed))).reshape(2, -1)
    inner += len(around)
    further, _ = _between([*around, *placed], outer, inner, *required, progress)
    return [*problems, *found, *further], distance


def _stretch(settings: PackSettings) -> float:
    """Return the ratio of the distance that parts keep along x and y to that along z."""
    across, along_z = settings.clearance, settings.clearance_z
    return 1.0 if along_z is None or along_z == across else across / along_z


def _in_place(part: PreparedPart, unit: float, where: str) -> _Placed:
    """Return an obstacle, whose file has the coordinates of the box."""
    return _Placed(_Original(part, unit), part.part.user_from_file, where)


def _wall(part: PreparedPart, unit: float) -> _Placed:
    """Return the mesh of a container, whose lowest corner is at (0, 0, 0)."""
    own = _in_place(part, unit, "the container")
    own.shift(-part.item_type.low)
    return own


def _is_around_part_of(placed: _Placed, wall: _Placed) -> bool:
    """Return whether a connected part of a wall that does not cross a part is inside it."""
    faces = np.asarray(wall.original.mesh.faces, dtype=np.int64)
    numbers = part_numbers(faces, len(wall.original.mesh.vertices))
    for corners in by_part(wall.vertices[faces], numbers):
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        if (placed.low <= low).all() and (high <= placed.high).all():
            triangles = np.asarray(placed.vertices)[np.asarray(placed.original.mesh.faces)]
            points = corners[np.linspace(0, len(corners) - 1, SAMPLES).astype(int)].mean(axis=1)
            if np.median(np.abs(winding_numbers(triangles, points))) > 0.5:
                return True
    return False


def _has_manifold() -> bool:
    return importlib.util.find_spec("manifold3d") is not None


def _read(part: Part) -> trimesh.Trimesh:
    """Read the mesh of a part's file again; take the given mesh if there is none."""
    if part.file is None or part.copy is None:
        return trimesh.Trimesh(part.mesh.vertices, part.mesh.faces)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of numpy and trimesh, about normals
        suffix = part.file.suffix.lower()
        if suffix == ".3mf":
            return read_3mf(part.copy, part.node)
        if suffix in SCENES:
            return read_scene(part, part.copy, suffix)
        content, kind = part.copy.content, suffix[1:]
        if kind == "obj":  # trimesh would cut polygons wrongly
            content = simple_faces(content)
        scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, skip_materials=True)
        if part.node is not None:
            graph = scene.graph
            below = [node for node in graph.nodes_geometry if part.node in _path(graph, node)]
            placed = [(scene.geometry[graph[n][1]].copy(), graph[n][0]) for n in below]
            meshes: Any = [mesh.apply_transform(pose) for mesh, pose in placed]
            joined: Any = trimesh.util.concatenate(meshes)
            return trimesh.Trimesh(joined.vertices, joined.faces, process=False)
        return scene.to_mesh()


def _path(graph: trimesh.scene.transforms.SceneGraph, node: str) -> list[str]:
    """Return a node and all above it."""
    path = [node]
    while path[-1] in graph.transforms.parents:
        path.append(graph.transforms.parents[path[-1]])
    return path


def _repair(mesh: trimesh.Trimesh, close: bool) -> None:
    """Repair the winding of a mesh by trimesh, and if wanted holes of 3 or 4 edges."""
    mesh.update_faces(mesh.unique_faces() & (mesh.area_faces > 0))
    mesh.remove_unreferenced_vertices()
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)
    if close:
        trimesh.repair.fill_holes(mesh)
    trimesh.repair.fix_inversion(mesh)


class _Original:
    """The mesh of a part's file at its real size, about the middle of its bounding box."""

    def __init__(self, prepared: PreparedPart, unit: float) -> None:
        part, scale = prepared.part, prepared.scale
        mesh = _read(part)
        used = np.asarray(mesh.vertices)[np.flatnonzero(np.bincount(mesh.faces.ravel()))]
        self.name = part.name
        self.length_unit = prepared.unit
        self.clearance = (part.clearance or 0.0) * scale
        middle = (used.min(axis=0) + used.max(axis=0)) / 2
        self.middle: Floats = middle * scale
        self.extents: Floats = np.ptp(used, axis=0) * scale
        self.unit = unit
        self.tolerance = checked_items.tolerance(unit, float(self.extents.max()))
        self.mesh = trimesh.Trimesh((mesh.vertices - middle) * scale, mesh.faces)
        was_closed = prepared.is_closed and prepared.filled_holes > 0
        _repair(self.mesh, was_closed)
        self.is_solid = was_closed or self.is_closed

    def length(self, value: float) -> str:
        """Return a length as text, such as "2.5 mm"."""
        return f"{value:.4g} {self.length_unit}"

    def drawn(self, times: int) -> Floats:
        """Return the factors that make it shorter along each axis by so many tolerances."""
        return np.maximum(self.extents - times * self.tolerance, 0) / self.extents

    @cached_property
    def samples(self) -> list[Floats]:
        """Points (n, 3) of each connected part of the surface, drawn in: middles of triangles."""
        faces = np.asarray(self.mesh.faces, dtype=np.int64)
        numbers = part_numbers(faces, len(self.mesh.vertices))
        middles = np.asarray(self.mesh.triangles_center) * self.drawn(1)
        groups = by_part(middles, numbers)
        return [own[np.linspace(0, len(own) - 1, SAMPLES).astype(int)] for own in groups]

    @cached_property
    def is_closed(self) -> bool:
        """True if it has a volume."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return bool(self.mesh.is_volume)


@bounded_cache(
    "meshes of checks", _MESHES, "meshes", lambda _: 1, lambda of, drawn_in=0: (of, drawn_in)
)
def _loose(of: _Original, drawn_in: int = 0) -> LooseMesh:
    """Return the mesh for FCL, drawn in some times.

    Once, so that parts that touch don't cross; twice for a wall, which is not drawn in.
    """
    vertices = np.asarray(of.mesh.vertices) * of.drawn(drawn_in)
    faces = np.asarray(of.mesh.faces, dtype=np.int64)
    return LooseMesh(vertices * (SIZE / of.unit), faces)


class _Placed:
    """A part at its pose."""

    def __init__(self, original: _Original, box_from_file: Motion, where: str) -> None:
        self.original = original
        self.name = f"{original.name} ({where})"
        self.box_from_item = box_from_file.at(box_from_file.apply(original.middle))
        vertices = self.vertices
        self.low, self.high = vertices.min(axis=0), vertices.max(axis=0)

    def shift(self, by: Floats) -> None:
        """Move it."""
        self.box_from_item = self.box_from_item.shifted(by)
        self.low, self.high = self.low + by, self.high + by

    def distance(self, other: _Placed, stretch: float) -> float:
        """Return the distance to another part, not below 0, after z is multiplied by a factor."""
        unit = self.original.unit / SIZE
        if stretch == 1:
            found = _loose(self.original).distance(_loose(other.original), *other.seen_from(self))
        else:
            meshes = [
                LooseMesh(
                    (each.vertices - self.low) * (1, 1, stretch) / unit,
                    np.asarray(each.original.mesh.faces, dtype=np.int64),
                )
                for each in (self, other)
            ]
            found = meshes[0].distance(meshes[1], (0, 0, 0))
        return max(found * unit, 0.0)

    @property
    def vertices(self) -> Floats:
        """The vertices (n, 3) in the box."""
        return self.box_from_item.apply(np.asarray(self.original.mesh.vertices))

    def seen_from(self, other: _Placed) -> tuple[Floats, Floats]:
        """Return translation and rotation in another part's frame, in FCL's numbers."""
        there = self.box_from_item.seen_from(other.box_from_item)
        return there.translation * (SIZE / self.original.unit), there.rotation.copy()


def _outside(
    placed: _Placed, container: Container, wall: _Placed | None, asked: WallClearance
) -> Iterator[str]:
    """Yield a sentence if a part is not inside its container, or too close to its walls."""
    low, high = placed.low, placed.high
    x, y, z = container.size
    beyond = [(asked.sides, depth) for depth in (-low[0], -low[1], high[0] - x, high[1] - y)]
    beyond += [(asked.floor, -low[2]), (asked.top, high[2] - z)]
    if isinstance(container, CylinderContainer):
        radius = container.diameter / 2
        from_axis = np.linalg.norm(placed.vertices[:, :2] - radius, axis=1)
        beyond.append((asked.sides, from_axis.max() - radius))
    unit, length = placed.original.unit, placed.original.length
    depths = [
        (float(depth + own) - (placed.original.tolerance if own == 0 else _ROUNDING * unit), own)
        for own, depth in beyond
    ]
    if not all(depth <= 0 for depth, _ in depths):
        depth, own = max(depths)
        what = "the box" if own == 0 else f"the clearance of {length(own)} to the walls"
        yield f"{placed.name} reaches {length(depth)} beyond {what}"
    elif wall is not None:
        clearance = asked.largest
        slack = placed.original.tolerance if clearance == 0 else _ROUNDING * unit
        yield from _beyond(placed, wall, clearance, slack)


def _beyond(placed: _Placed, wall: _Placed, clearance: float, slack: float) -> Iterator[str]:
    """Yield a sentence if a part is not inside a closed mesh, or too close to it."""
    there = placed.seen_from(wall)
    if _loose(wall.original).crosses(_loose(placed.original, 2), *there):
        yield f"{placed.name} crosses the container's wall"
        return
    triangles = np.asarray(wall.original.mesh.triangles)
    motion = placed.box_from_item.seen_from(wall.box_from_item)
    for samples in placed.original.samples:
        if np.median(np.abs(winding_numbers(triangles, motion.apply(samples)))) < 0.5:
            yield f"{placed.name} is not inside the container, in part or whole"
            return
    if placed.original.is_solid and _is_around_part_of(placed, wall):
        yield f"{placed.name} is around a part of the container's wall"
    if clearance > 0:
        unit, length = placed.original.unit, placed.original.length
        distance = _loose(wall.original).distance(_loose(placed.original), *there) * unit / SIZE
        if not distance >= clearance - slack:
            yield (
                f"{placed.name} is {length(max(distance, 0.0))} from the container's wall: "
                f"less than {length(clearance)}"
            )


def _between(
    placed: Sequence[_Placed],
    first: Ints,
    second: Ints,
    general: float,
    stretch: float,
    progress: Progress,
) -> tuple[list[str], float | None]:
    """Return the problems of pairs (n,) and (n,) of parts, and the smallest distance.

    Distances are those after z is multiplied by a factor.
    """
    own = np.array([max(general, each.original.clearance) for each in placed])
    needed = np.maximum(own[first], own[second])
    low = np.array([each.low for each in placed]).reshape(-1, 3)
    high = np.array([each.high for each in placed]).reshape(-1, 3)
    sides = np.maximum(low[first], low[second]) - np.minimum(high[first], high[second])
    sides *= (1, 1, stretch)
    gaps, overlaps = np.linalg.norm(np.maximum(sides, 0), axis=1), (sides < 0).all(axis=1)
    most = float(needed.max(initial=0.0))
    is_near = (gaps < most) | overlaps
    near = int(np.count_nonzero(is_near))
    problems: list[str] = []
    least: float | None = None
    lowest = np.minimum(low[first, 2], low[second, 2])  # from below: few meshes at a time
    for n, pair in enumerate(np.lexsort((np.where(is_near, lowest, gaps), ~is_near)).tolist()):
        progress("checking the distances", min(n, near), near)
        one, other = placed[first[pair]], placed[second[pair]]
        unit, clearance = one.original.unit, float(needed[pair])
        if not is_near[pair] and least is not None and gaps[pair] >= least:
            break
        if clearance > 0 or least is None or least > 0:
            distance = one.distance(other, stretch)
            least = distance if least is None else min(least, distance)
            if clearance > 0 and not distance >= clearance - _ROUNDING * unit:
                length = one.original.length
                problems.append(
                    f"{other.name} is {length(distance)} from {one.name}: "
                    f"less than {length(clearance)}"
                )
        if overlaps[pair]:
            problems += _overlap(one, other)
    return problems, least


def _is_inside(own: _Placed, around: _Placed) -> bool:
    """Return whether a connected part of a surface is inside a closed one; they don't cross."""
    triangles = np.asarray(around.original.mesh.triangles)
    low, high = around.original.mesh.bounds
    for samples in own.original.samples:
        points = own.box_from_item.seen_from(around.box_from_item).apply(samples)
        within = ((low < points) & (points < high)).all(axis=1)  # no surface winds around others
        if 2 * np.count_nonzero(within) < len(points):
            continue
        winds = np.zeros(len(points))
        winds[within] = np.abs(winding_numbers(triangles, points[within]))
        if np.median(winds) > 0.5:
            return True
    return False


def _overlap(one: _Placed, other: _Placed) -> Iterator[str]:
    """Yield a sentence if two parts overlap: surfaces cross, or closed parts share a volume."""
    if _loose(one.original, 1).crosses(_loose(other.original, 1), *other.seen_from(one)):
        yield f"{other.name} crosses {one.name}"
        return
    for own, around in ((one, other), (other, one)):
        if around.original.is_solid and _is_inside(own, around):
            yield f"{own.name} is inside {around.name}, in part or whole"
            return
    if one.original.is_closed and other.original.is_closed and _has_manifold():
        solids = [
            trimesh.Trimesh(each.vertices, each.original.mesh.faces, process=False)
            for each in (one, other)
        ]
        shared = trimesh.boolean.intersection(solids, engine="manifold")
        with np.errstate(divide="ignore", invalid="ignore"):  # parts may share a face
            depth = 0.0 if shared.is_empty else 2 * abs(float(shared.volume)) / float(shared.area)
        if depth > np.sqrt(3) * max(one.original.tolerance, other.original.tolerance):
            shared_volume = f"{abs(shared.volume):.4g} {one.original.length_unit}³"
            yield f"{other.name} and {one.name} share a volume of {shared_volume}"
