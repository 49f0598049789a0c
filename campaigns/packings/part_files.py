"""Random files of parts in all formats, with their truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from campaigns.packings import mesh_writers, plate_writers, scene_writers, step_writer
from campaigns.packings.random_parts import Random, motion, random_shape
from campaigns.packings.scenes import Node, Scene
from campaigns.packings.shapes import Floats, Shape, united
from campaigns.packings.truth import MILLIMETRES, TruePart

UP: Mapping[str, Floats] = {
    "x": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "z": np.eye(3),
}
"""From a file with this axis up to z up."""

SCENES = ("GLB", "GLB, copies", "GLB, instances", "glTF", "COLLADA")

KINDS = (*mesh_writers.WRITERS, *SCENES, "3MF, core", "3MF, production", "STEP")
"""The formats."""


@dataclass
class PartFiles:
    """A folder of random files.

    Attributes
    ----------
    up : str, optional
        The axis of all files that points up; by default as their formats define.
    unit : str
        The unit of files that don't define it.
    split : bool, optional
        Whether each part of a scene is packed by itself; by default those of 3MF and STEP are.
    rotations : str
        The set of rotations of parts whose row does not say.
    parts : list of TruePart
        The parts of all files so far.
    """

    rng: Random
    folder: Path
    up: str | None
    unit: str
    split: bool | None
    rotations: str
    parts: list[TruePart] = field(default_factory=list)

    def add(self, number: int, kind: str, row: dict[str, Any], shape: Shape | None = None) -> Path:
        """Write a file, and add its parts; that of a mesh may have a given shape."""
        stem = f"p{number}-{self.rng.choice(['part', 'größe', 'a b'])}"
        if kind in mesh_writers.WRITERS:
            return self._mesh(stem, kind, row, shape or random_shape(self.rng, flawed=True))
        if kind == "STEP":
            return self._step(stem, row)
        return self._scene(stem, kind, row)

    def _part(
        self, path: Path, kind: str, shape: Shape, places: Sequence[Floats], row: dict[str, Any]
    ) -> TruePart:
        return TruePart(
            file=f"{path.name.partition('-')[0]}-",
            token="",
            kind=kind,
            shape=shape,
            user_from_shape=tuple(places),
            up=np.eye(3),
            count=int(row["count"]) * len(places),
            rotations=str(row.get("rotations", self.rotations)),
            density=row.get("density"),
            rounding=0.0,
        )

    def add_keep_out(self, shape: Shape) -> Path:
        """Write the file of a volume of the box that stays free."""
        path = self.folder / "keep-out.stl"
        vertices = shape.vertices @ UP[self.up or "z"] / MILLIMETRES[self.unit]
        mesh_writers.binary_stl(path, replace(shape, vertices=vertices))
        return path

    def _mesh(self, stem: str, kind: str, row: dict[str, Any], shape: Shape) -> Path:
        suffix, write = mesh_writers.WRITERS[kind]
        place = motion(self.rng, far=True)
        up, unit = UP[self.up or "z"], MILLIMETRES[row.get("unit", self.unit)]
        moved = shape.moved(place)
        in_file = replace(moved, vertices=moved.vertices @ up / unit)
        path = self.folder / f"{stem}{suffix}"
        rounding = write(path, in_file) * float(np.abs(moved.vertices).max())
        part = self._part(path, kind, shape, [place], row)
        self.parts.append(replace(part, up=up, rounding=rounding))
        return path

    def _step(self, stem: str, row: dict[str, Any]) -> Path:
        unit = str(self.rng.choice(list(step_writer.UNITS)))
        count = int(self.rng.choice([1, 1, 2]))
        up = UP[self.up or "z"]
        place = motion(self.rng, far=False)
        shapes = [random_shape(self.rng, planar=True) for _ in range(count)]
        shift = np.eye(4)
        shift[0, 3] = 100.0
        places = [np.linalg.matrix_power(shift, n) @ place for n in range(count)]
        names = [f"q{letter} solid" for letter in "ab"[:count]]
        path = self.folder / f"{stem}{self.rng.choice(['.step', '.stp'])}"
        moved = [one.moved(own) for one, own in zip(shapes, places, strict=True)]
        in_file = [
            replace(one, vertices=one.vertices @ up / step_writer.UNITS[unit]) for one in moved
        ]
        rounding = step_writer.step(path, names, in_file, unit)
        rounding = max(rounding, 1e-7) * max(float(np.abs(one.vertices).max()) for one in moved)
        for shape, own, name in zip(shapes, places, names, strict=True):
            part = self._part(path, "STEP", shape, [own], row)
            token = name[:2] if count > 1 else ""
            self.parts.append(replace(part, up=up, rounding=rounding, token=token))
        return path

    def _scene(self, stem: str, kind: str, row: dict[str, Any]) -> Path:
        rng, is_3mf = self.rng, kind.startswith("3MF")
        is_split = is_3mf if self.split is None else self.split
        is_one = kind in ("GLB", "GLB, copies", "GLB, instances")
        meshes = 1 if is_one else int(rng.choice([1, 1, 2]))
        copies = 1 if kind == "GLB" else int(rng.integers(1 if meshes > 1 or not is_one else 2, 4))
        bodies = [
            [random_shape(rng) for _ in range(2 if is_3mf and rng.random() < 0.4 else 1)]
            for _ in range(meshes)
        ]
        shapes, assembled = [], {}
        for n, own in enumerate(bodies):
            if len(own) > 1:
                own[1] = own[1].moved(_beside(own[0], own[1]))
                assembled[n] = own
            shapes.append(united(own) if len(own) > 1 else own[0])
        names = tuple(
            f"q{letter} {rng.choice(['Haken groß', 'деталь', '[x]', 'plate'])}"
            for letter in "ab"[:meshes]
        )
        nodes: list[Node] = []
        x = 0.0
        start = motion(rng, far=rng.random() < 0.3)
        is_turned = rng.random() < 0.3
        for n, shape in enumerate(shapes):
            turn = motion(rng, far=False)
            for k in range(copies):
                turn = motion(rng, far=False) if is_turned and k else turn
                size = 2.0 if is_3mf and k and rng.random() < 0.1 else 1.0
                place = np.eye(4)
                place[:3, :3] = turn[:3, :3] * size
                corners = shape.moved(place).vertices
                place[:3, 3] = np.array([x, 0, 0]) - corners.min(axis=0)
                x += float(np.ptp(corners[:, 0])) + 7
                place[:3, 3] += start[:3, 3]
                is_printed = not (is_3mf and len(nodes) > 0 and rng.random() < 0.1)
                nodes.append(Node(n, place, is_printed))
        suffix, unit, up = ".3mf", 1000.0, UP[self.up or ("z" if is_3mf else "y")]
        unit_name: str | None = None
        if is_3mf:
            unit_name = str(rng.choice([*plate_writers.UNITS, "millimeter", "millimeter"]))
            unit = plate_writers.UNITS[unit_name]
        elif kind == "COLLADA":
            unit = float(rng.choice([1000.0, 1.0, 10.0, 25.4, 2.5]))
            up = UP[self.up or str(rng.choice(list(UP)))]
        inner = (
            1 / unit if is_3mf and rng.random() < 0.7 else float(rng.choice([1 / unit, 1.0, 0.1]))
        )
        scene = Scene(names, tuple(shapes), tuple(nodes), unit, up, inner)
        suffix = {"3MF": ".3mf", "GLB": ".glb", "glTF": ".gltf", "COLLADA": ".dae"}[
            kind.partition(",")[0]
        ]
        path = self.folder / f"{stem}{suffix}"
        if kind == "3MF, core":
            told = None if unit_name == "millimeter" and rng.random() < 0.3 else unit_name
            rounding = plate_writers.core_3mf(path, scene, told, assembled)
        elif kind == "3MF, production":
            assert unit_name is not None
            rounding = plate_writers.production_3mf(path, scene, unit_name, assembled)
        elif kind == "COLLADA":
            rounding = scene_writers.collada(path, scene)
        elif kind == "glTF":
            rounding = scene_writers.gltf(path, scene)
        else:
            rounding = scene_writers.glb(path, scene, kind == "GLB, instances")
        farthest = max(
            float(np.abs(shapes[node.mesh].moved(node.user_from_mesh).vertices).max())
            for node in nodes
        )
        self._add_scene(path, kind, scene, is_split, row, 4 * rounding * (farthest + 100))
        return path

    def _add_scene(
        self,
        path: Path,
        kind: str,
        scene: Scene,
        is_split: bool,
        row: dict[str, Any],
        rounding: float,
    ) -> None:
        groups: dict[tuple[int, float], list[Floats]] = {}
        for node in scene.nodes:
            size = float(np.cbrt(np.linalg.det(node.user_from_mesh[:3, :3])))
            place = node.user_from_mesh.copy()
            place[:3, :3] /= size
            if node.is_printed:
                groups.setdefault((node.mesh, round(size, 6)), []).append(place)
        found = []
        for (mesh, size), places in groups.items():
            shape = replace(scene.shapes[mesh], vertices=scene.shapes[mesh].vertices * size)
            found.append((shape, places, scene.names[mesh][:2] if len(scene.names) > 1 else ""))
        if not is_split and sum(len(places) for _, places, _ in found) > 1:
            placed = [shape.moved(place) for shape, places, _ in found for place in places]
            found = [(united(placed), [np.eye(4)], "")]
        for shape, places, token in found:
            part = self._part(path, kind, shape, places, row)
            self.parts.append(replace(part, token=token, up=scene.up, rounding=rounding))


def _beside(one: Shape, other: Shape) -> Floats:
    """Return the motion that puts a shape beside another."""
    shift = np.eye(4)
    shift[:3, 3] = one.vertices.max(axis=0) - other.vertices.min(axis=0) + 0.5
    shift[1:3, 3] = one.vertices.min(axis=0)[1:] - other.vertices.min(axis=0)[1:]
    return shift
