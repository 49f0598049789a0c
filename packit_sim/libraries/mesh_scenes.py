"""Scenes of meshes that trimesh has read, as one mesh or as parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from typing import Any

import numpy as np
import trimesh

from packit_sim.core.errors import MeshError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.motions import split
from packit_sim.libraries import gltf_files
from packit_sim.libraries.raw_meshes import RawMesh, RawPart


@dataclass(frozen=True, eq=False)
class MeshScene:
    """A file's scene, its up axis, its unit, notes, and its meshes' deviations by name."""

    scene: trimesh.Scene
    up: str
    unit_cm: float | None
    notes: tuple[str, ...] = ()
    deviations: Mapping[str, float] = field(default_factory=dict)

    def joined(self) -> RawMesh:
        """Join all meshes."""
        placed = [self.scene.graph[node][1] for node in self.scene.graph.nodes_geometry]
        meshes = sum(self._is_mesh(name) for name in placed)
        return self._raw(self.scene.to_mesh(), meshes, list(map(str, placed)))

    def separate(self) -> list[RawPart]:
        """Join the meshes below each of the uppermost nodes; count equal ones."""
        graph = self.scene.graph
        found: dict[object, RawPart] = {}
        groups = self._groups()
        digests = {name: _digest(mesh) for name, mesh in self.scene.geometry.items()}
        for name, nodes in groups.items():
            inside = [graph.get(node, name) for node in nodes]
            own = [(digests[each], _rounded(matrix)) for matrix, each in inside]
            key = (tuple(own), _rounded(split(graph.get(name)[0])[0]))
            if key in found:
                title = str(inside[0][1]) if len(inside) == 1 else found[key].name
                found[key] = replace(found[key], name=title, count=found[key].count + 1)
                continue
            placed = [
                (self.scene.geometry[geometry].copy(), matrix)
                for matrix, geometry in map(graph.get, nodes)
            ]
            meshes = [mesh.apply_transform(matrix) for mesh, matrix in placed]
            mesh = meshes[0] if len(meshes) == 1 else trimesh.util.concatenate(meshes)
            address = self._address(name) if len(groups) > 1 else None
            names = [str(geometry) for _, geometry in inside]
            found[key] = RawPart(name, self._raw(mesh, len(meshes), names), node=address)
        return list(found.values())

    def _groups(self) -> dict[str, list[str]]:
        """Group the nodes with meshes by the uppermost node above them."""
        graph = self.scene.graph
        parents = graph.transforms.parents
        nodes = [node for node in graph.nodes_geometry if self._is_mesh(graph[node][1])]
        paths = []
        for node in nodes:
            metadata = self.scene.geometry[graph[node][1]].metadata
            path = [parents[node] if metadata.get("from_gltf_primitive") else node]
            while path[-1] in parents:
                path.append(parents[path[-1]])
            paths.append(path[::-1])
        level = 0
        shortest = min(map(len, paths))
        while level < shortest - 1 and len({path[level] for path in paths}) == 1:
            level += 1
        groups: dict[str, list[str]] = {}
        for node, path in zip(nodes, paths, strict=True):
            below = level + 1
            is_instance = below < len(path) and self._instance(path[below]) is not None
            groups.setdefault(str(path[below if is_instance else level]), []).append(node)
        return groups

    def _instance(self, node: str) -> int | None:
        """Return the number of an instance of a mesh that its parent shows several times."""
        transforms = self.scene.graph.transforms
        edge = transforms.edge_data.get((transforms.parents.get(node), node), {})
        number: int | None = (edge.get("metadata") or {}).get(gltf_files.INSTANCING)
        return number

    def _address(self, node: str) -> str:
        """Return what finds a node in the file: an instance by its parent and number."""
        number = self._instance(node)
        return node if number is None else f"{self.scene.graph.transforms.parents[node]}[{number}]"

    def _is_mesh(self, name: object) -> bool:
        return isinstance(self.scene.geometry[str(name)], trimesh.Trimesh)

    def _raw(self, mesh: Any, parts: int, names: Sequence[str]) -> RawMesh:
        for name, array in (("vertices", mesh.vertices), ("triangles", mesh.faces)):
            if array.ndim != 2 or array.shape[1] != 3:
                raise MeshError(
                    f"its {name} must have three numbers each, not the shape {array.shape}"
                )
        deviation = max((self.deviations.get(name, 0.0) for name in names), default=0.0)
        return RawMesh(mesh, self.up, self.unit_cm, parts, self.notes, deviation)


def _digest(mesh: Any) -> bytes:
    digest = sha256(np.ascontiguousarray(mesh.vertices).tobytes())
    digest.update(np.ascontiguousarray(getattr(mesh, "faces", ())).tobytes())
    return digest.digest()


def _rounded(matrix: Floats) -> bytes:
    """Return a matrix without rounding errors, for comparisons."""
    return (np.round(matrix, 9) + 0.0).tobytes()
