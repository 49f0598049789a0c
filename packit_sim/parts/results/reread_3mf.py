"""A second, minimal reader of 3MF files, for the check.

It shares no code with the first one, `libraries/mesh_3mf.py`: it decides anew, by the XML alone,
which objects, components and transforms a part consists of. Numbers have single precision, as in
the libraries and slicers that read the format.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from functools import lru_cache
from urllib.parse import unquote
from zipfile import ZipFile

import numpy as np
import trimesh
from lxml import etree

from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.parts.reading.file_copies import FileCopy

_PATH = "{http://schemas.microsoft.com/3dmanufacturing/production/2015/06}path"
_TYPES = ("support", "solidsupport", "surface", "other")
_NOT_SOLID = {"ParameterModifier", "SupportBlocker", "SupportEnforcer"}
_NOT_SOLID |= {"modifier_part", "support_blocker", "support_enforcer"}
_CURA = {f"cura:{what}_mesh" for what in ("anti_overhang", "cutting", "infill", "support")}


def read_3mf(file: FileCopy, item: str | None) -> trimesh.Trimesh:
    """Read the mesh of one item of a 3MF file's build, by its number from 1, or of all to print."""
    package = _package(file)
    if item is None:
        items = [own for own in package.items if own.get("printable") not in ("0", "false")]
    else:
        items = [package.items[int(item) - 1]]
    vertices, faces, count = [], [], 0
    for own in items:
        for points, triangles in package.meshes(own, package.root, np.eye(4)):
            vertices.append(points)
            faces.append(triangles + count)
            count += len(points)
    return trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)


class _Package:
    """The items and objects of a 3MF file."""

    def __init__(self, content: bytes) -> None:
        with ZipFile(io.BytesIO(content)) as archive:
            read = {_key(name): archive.read(name) for name in archive.namelist()}
        relations = etree.fromstring(read["_rels/.rels"]).iter("{*}Relationship")
        kinds = {one.get("Type").rpartition("/")[2]: one.get("Target") for one in relations}
        self.root = _key(kinds["3dmodel"])
        self.objects = {}
        for path, data in read.items():
            if path.endswith(".model"):
                model = etree.fromstring(data)
                for own in model.iterfind("{*}resources/{*}object"):
                    self.objects[path, int(own.get("id"))] = _Object(own)
                if path == self.root:
                    self.items = [dict(own.attrib) for own in model.iterfind("{*}build/{*}item")]
        for name in ("metadata/slic3r_pe_model.config", "metadata/model_settings.config"):
            for one in etree.fromstring(read[name]).iterfind("object") if name in read else ():
                own_object = self.objects.get((self.root, int(one.get("id"))))
                volumes = [each for each in one if each.tag in ("part", "volume")]
                if own_object is not None:
                    own_object.leave_out([each for each in volumes if _kind(each) in _NOT_SOLID])

    def meshes(
        self, reference: dict[str, str], path: str, place: Floats
    ) -> Iterator[tuple[Floats, Ints]]:
        """Yield the solid meshes that an item or a component refers to, at its place."""
        numbers = reference.get("transform", "1 0 0 0 1 0 0 0 1 0 0 0").split()
        within = np.eye(4)
        within[:3] = np.array(numbers, np.float32).reshape(4, 3).T
        place = place @ within
        path = _key(reference.get(_PATH, path))
        own = self.objects[path, int(reference["objectid"])]
        if own.is_solid:
            for component in own.components:
                yield from self.meshes(component, path, place)
            faces = own.faces[:, ::-1] if np.linalg.det(place[:3, :3]) < 0 else own.faces
            yield own.points @ place[:3, :3].T + place[:3, 3], faces


@lru_cache(maxsize=1)
def _package(file: FileCopy) -> _Package:
    """Read a package, and keep it for its other parts."""
    return _Package(file.content)


class _Object:
    """An object of a 3MF file."""

    def __init__(self, own: etree._Element) -> None:
        cura = own.iterfind("{*}metadatagroup/{*}metadata")
        roles = [one.get("name") for one in cura if (one.text or "").lower() == "true"]
        self.is_solid = own.get("type") not in _TYPES and not _CURA & set(roles)
        self.components = [dict(one.attrib) for one in own.iterfind("{*}components/{*}component")]
        vertices = own.iterfind("{*}mesh/{*}vertices/{*}vertex")
        triangles = own.iterfind("{*}mesh/{*}triangles/{*}triangle")
        points = [[one.get(axis) for axis in "xyz"] for one in vertices]
        self.points: Floats = np.array(points, np.float32).reshape(-1, 3).astype(float)
        corners = [[int(one.get(corner)) for corner in ("v1", "v2", "v3")] for one in triangles]
        self.faces: Ints = np.array(corners, np.int64).reshape(-1, 3)

    def leave_out(self, volumes: list[etree._Element]) -> None:
        """Leave out volumes by a slicer's settings: components, or ranges of triangles."""
        parts = {int(one.get("id")) for one in volumes if one.tag == "part"}
        self.components = [one for one in self.components if int(one["objectid"]) not in parts]
        kept = np.ones(len(self.faces), dtype=bool)
        for one in volumes:
            if one.tag == "volume":
                kept[int(one.get("firstid")) : int(one.get("lastid")) + 1] = False
        self.faces = self.faces[kept]


def _key(name: str) -> str:
    """Return the name of a file in a package as it is compared."""
    return unquote(name).lstrip("/").lower()


def _kind(volume: etree._Element) -> str:
    """Return what a slicer's volume is."""
    said = {one.get("key"): one.get("value") for one in volume.iterfind("metadata")}
    old = "ParameterModifier" if said.get("modifier") == "1" else "ModelPart"
    return str(volume.get("subtype") or said.get("volume_type", old))
