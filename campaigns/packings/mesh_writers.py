"""Writers of files with one mesh: STL, OBJ, PLY and OFF, by their specifications alone.

Each writes a shape in the coordinates of its file, and returns the relative rounding of these.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from campaigns.packings.shapes import Shape

SINGLE = 2.0**-24
"""Relative rounding of single precision."""

TEXT = 1e-9
"""Relative rounding of the numbers in text."""

Face = tuple[int, ...]


def triangles_of(shape: Shape) -> list[Face]:
    """Return the triangles that a file has: some lack, or are clockwise."""
    kept = shape.triangles[: len(shape.triangles) - shape.missing]
    return [tuple(int(k) for k in (t[::-1] if shape.inverted else t)) for t in kept]


def polygons_of(shape: Shape) -> list[Face]:
    """Return the same in polygons."""
    kept = shape.polygons[: len(shape.polygons) - shape.missing]
    return [face[::-1] if shape.inverted else face for face in kept]


def text_of(numbers: np.ndarray) -> str:
    """Write numbers with spaces between them."""
    return " ".join(f"{each:.10g}" for each in numbers)


def binary_stl(path: Path, shape: Shape) -> float:
    """Write binary STL."""
    faces = triangles_of(shape)
    data = bytearray(b"made by a campaign".ljust(80)) + struct.pack("<I", len(faces))
    for face in faces:
        data += struct.pack("<12fH", 0, 0, 0, *shape.vertices[list(face)].ravel(), 0)
    path.write_bytes(bytes(data))
    return SINGLE


def ascii_stl(path: Path, shape: Shape) -> float:
    """Write ASCII STL."""
    lines = ["solid part"]
    for face in triangles_of(shape):
        lines += ["  facet normal 0 0 0", "    outer loop"]
        lines += [f"      vertex {text_of(shape.vertices[k])}" for k in face]
        lines += ["    endloop", "  endfacet"]
    path.write_text("\n".join([*lines, "endsolid part"]) + "\n")
    return TEXT


def _obj(path: Path, shape: Shape, faces: list[Face], relative: bool) -> float:
    count = len(shape.vertices)
    lines = ["# a mesh", "o part", *(f"v {text_of(each)}" for each in shape.vertices)]
    for face in faces:
        own = [k - count if relative else k + 1 for k in face]
        lines.append(f"f {' '.join(map(str, own))}")
    path.write_text("\n".join(lines) + "\n")
    return TEXT


def triangle_obj(path: Path, shape: Shape) -> float:
    """Write OBJ with triangles."""
    return _obj(path, shape, triangles_of(shape), relative=False)


def polygon_obj(path: Path, shape: Shape) -> float:
    """Write OBJ with polygons, and with vertices counted from the last one."""
    return _obj(path, shape, polygons_of(shape), relative=True)


def _ply_head(kind: str, number: str, vertices: int, faces: int) -> str:
    lines = ["ply", f"format {kind} 1.0", "comment a mesh", f"element vertex {vertices}"]
    lines += [f"property {number} {axis}" for axis in "xyz"]
    lines += [f"element face {faces}", "property list uchar int vertex_indices", "end_header"]
    return "\n".join(lines) + "\n"


def ascii_ply(path: Path, shape: Shape) -> float:
    """Write PLY in text, with triangles."""
    faces = triangles_of(shape)
    lines = [text_of(each) for each in shape.vertices]
    lines += [f"{len(face)} {' '.join(map(str, face))}" for face in faces]
    head = _ply_head("ascii", "double", len(shape.vertices), len(faces))
    path.write_text(head + "\n".join(lines) + "\n")
    return TEXT


def _binary_ply(path: Path, shape: Shape, order: str) -> float:
    faces, (mark, kind) = triangles_of(shape), order.split()
    data = _ply_head(kind, "float", len(shape.vertices), len(faces)).encode()
    data += shape.vertices.astype(f"{mark}f4").tobytes()
    for face in faces:
        data += struct.pack(f"{mark}B{len(face)}i", len(face), *face)
    path.write_bytes(data)
    return SINGLE


def little_ply(path: Path, shape: Shape) -> float:
    """Write binary PLY, the least byte first."""
    return _binary_ply(path, shape, "< binary_little_endian")


def big_ply(path: Path, shape: Shape) -> float:
    """Write binary PLY, the greatest byte first."""
    return _binary_ply(path, shape, "> binary_big_endian")


def off(path: Path, shape: Shape) -> float:
    """Write OFF, with polygons where they are convex."""
    faces = triangles_of(shape)
    if all(len(face) <= 4 for face in shape.polygons):
        faces = polygons_of(shape)
    lines = ["OFF", f"{len(shape.vertices)} {len(faces)} 0"]
    lines += [text_of(each) for each in shape.vertices]
    lines += [f"{len(face)} {' '.join(map(str, face))}" for face in faces]
    path.write_text("\n".join(lines) + "\n")
    return TEXT


WRITERS: Mapping[str, tuple[str, Callable[[Path, Shape], float]]] = {
    "STL, binary": (".stl", binary_stl),
    "STL, ASCII": (".stl", ascii_stl),
    "OBJ, triangles": (".obj", triangle_obj),
    "OBJ, polygons": (".obj", polygon_obj),
    "PLY, ASCII": (".ply", ascii_ply),
    "PLY, little-endian": (".ply", little_ply),
    "PLY, big-endian": (".ply", big_ply),
    "OFF": (".off", off),
}
"""The suffix and the writer of each format."""
