"""A writer of STEP files (AP214): solids with planar faces."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from campaigns.packings.mesh_writers import TEXT
from campaigns.packings.shapes import Floats, Shape

UNITS = {"mm": 1.0, "cm": 10.0, "in": 25.4, "m": 1000.0}
"""Millimetres in the units of the files."""

_PREFIX = {"mm": ".MILLI.", "cm": ".CENTI.", "m": "$"}


class _Entities:
    """The data section: lines with numbers."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def add(self, text: str) -> str:
        """Add an entity, and return its reference."""
        self.lines.append(f"#{len(self.lines) + 1}={text};")
        return f"#{len(self.lines)}"

    def point(self, values: Floats) -> str:
        return self.add(f"CARTESIAN_POINT('',({_numbers(values)}))")

    def direction(self, values: Floats) -> str:
        return self.add(f"DIRECTION('',({_numbers(values)}))")

    def axes(self, origin: Floats, z: Floats, x: Floats) -> str:
        refs = self.point(origin), self.direction(z), self.direction(x)
        return self.add(f"AXIS2_PLACEMENT_3D('',{','.join(refs)})")


def _numbers(values: Floats) -> str:
    """Write reals, which have a point in STEP."""
    texts = (f"{each:.12f}".rstrip("0") for each in np.asarray(values) + 0.0)
    return ",".join(texts)


def _length_unit(out: _Entities, unit: str) -> str:
    if unit in _PREFIX:
        return out.add(f"(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT({_PREFIX[unit]},.METRE.))")
    base = out.add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
    size = out.add(
        f"LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE({_numbers(np.array([UNITS[unit]]))}),{base})"
    )
    exponents = out.add("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)")
    return out.add(f"(CONVERSION_BASED_UNIT('INCH',{size})LENGTH_UNIT()NAMED_UNIT({exponents}))")


def _solid(out: _Entities, name: str, shape: Shape) -> str:
    """Add a solid with planar faces, whose edges are shared."""
    points = [out.point(each) for each in shape.vertices]
    corners = [out.add(f"VERTEX_POINT('',{point})") for point in points]
    edges: dict[tuple[int, int], str] = {}
    faces = []
    for polygon in shape.polygons:
        oriented = []
        for a, b in zip(polygon, [*polygon[1:], polygon[0]], strict=True):
            if (b, a) not in edges and (a, b) not in edges:
                along = shape.vertices[b] - shape.vertices[a]
                length = float(np.linalg.norm(along))
                vector = out.add(f"VECTOR('',{out.direction(along / length)},1.)")
                line = out.add(f"LINE('',{points[a]},{vector})")
                edges[a, b] = out.add(f"EDGE_CURVE('',{corners[a]},{corners[b]},{line},.T.)")
            sense = ".T." if (a, b) in edges else ".F."
            edge = edges.get((a, b)) or edges[b, a]
            oriented.append(out.add(f"ORIENTED_EDGE('',*,*,{edge},{sense})"))
        loop = out.add(f"EDGE_LOOP('',({','.join(oriented)}))")
        bound = out.add(f"FACE_OUTER_BOUND('',{loop},.T.)")
        ring = shape.vertices[list(polygon)]
        normal = np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
        along = ring[1] - ring[0]
        normal /= np.linalg.norm(normal)
        axes = out.axes(ring[0], normal, along / np.linalg.norm(along))
        plane = out.add(f"PLANE('',{axes})")
        faces.append(out.add(f"ADVANCED_FACE('',({bound}),{plane},.T.)"))
    shell = out.add(f"CLOSED_SHELL('',({','.join(faces)}))")
    return out.add(f"MANIFOLD_SOLID_BREP('{name}',{shell})")


def step(path: Path, names: Sequence[str], shapes: Sequence[Shape], unit: str) -> float:
    """Write a product with a solid for each shape, which has the coordinates of the file."""
    out = _Entities()
    context = out.add("APPLICATION_CONTEXT('automotive design')")
    out.add(
        "APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,"
        f"{context})"
    )
    product_context = out.add(f"PRODUCT_CONTEXT('',{context},'mechanical')")
    definition_context = out.add(
        f"PRODUCT_DEFINITION_CONTEXT('part definition',{context},'design')"
    )
    length = _length_unit(out, unit)
    angle = out.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    solid = out.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    accuracy = out.add(
        f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-07),{length},'accuracy','')"
    )
    space = out.add(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT"
        f"(({accuracy}))GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle},{solid}))"
        "REPRESENTATION_CONTEXT('',''))"
    )
    for name, shape in zip(names, shapes, strict=True):
        product = out.add(f"PRODUCT('{name}','{name}','',({product_context}))")
        out.add(f"PRODUCT_RELATED_PRODUCT_CATEGORY('part',$,({product}))")
        formation = out.add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
        definition = out.add(f"PRODUCT_DEFINITION('design','',{formation},{definition_context})")
        owner = out.add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
        body = _solid(out, name, shape)
        origin = out.axes(np.zeros(3), np.array([0.0, 0, 1]), np.array([1.0, 0, 0]))
        shown = out.add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('{name}',({origin},{body}),{space})")
        out.add(f"SHAPE_DEFINITION_REPRESENTATION({owner},{shown})")
    data = "\n".join(out.lines)
    path.write_text(
        "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\n"
        f"FILE_NAME('{path.name}','2026-01-01T00:00:00',(''),(''),'','','');\n"
        "FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));\nENDSEC;\n"
        f"DATA;\n{data}\nENDSEC;\nEND-ISO-10303-21;\n"
    )
    return TEXT
