"""STEP files (AP214) of our own: boxes and cylinders, in assemblies, in any unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

Point = Sequence[float]

UNITS = {
    "mm": "( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) )",
    "m": "( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT($,.METRE.) )",
    "in": "( CONVERSION_BASED_UNIT('INCH',{inch}) LENGTH_UNIT() NAMED_UNIT({exponents}) )",
}

_FRAME = """ISO-10303-21;
HEADER;
FILE_DESCRIPTION((''),'2;1');
FILE_NAME('','2026-01-01T00:00:00',(''),(''),'','','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN {{ 1 0 10303 214 1 1 1 1 }}'));
ENDSEC;
DATA;
{}
ENDSEC;
END-ISO-10303-21;
"""


def _real(value: float) -> str:
    text = f"{float(value):.15G}"
    return text if "." in text else text.replace("E", ".E") if "E" in text else f"{text}."


def _text(name: str) -> str:
    """Write a string as Part 21 does: other characters than ASCII as UTF-16."""
    found = ""
    for character in name.replace("'", "''"):
        code = character.encode("utf-16-be").hex().upper()
        found += character if character.isascii() else f"\\X2\\{code}\\X0\\"
    return f"'{found}'"


@dataclass
class Step:
    """A file that grows by entities."""

    unit: str = "mm"
    lines: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        mm = self.add(UNITS["mm"])
        exponents = self.add("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)")
        inch = self.add(f"LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),{mm})")
        length = self.add(UNITS[self.unit].format(inch=inch, exponents=exponents))
        angle = self.add("( NAMED_UNIT(*) PLANE_ANGLE_UNIT() SI_UNIT($,.RADIAN.) )")
        solid = self.add("( NAMED_UNIT(*) SI_UNIT($,.STERADIAN.) SOLID_ANGLE_UNIT() )")
        near = self.add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-7),{length},'','')")
        self.context = self.add(
            f"( GEOMETRIC_REPRESENTATION_CONTEXT(3) GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({near})) "
            f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle},{solid})) "
            "REPRESENTATION_CONTEXT('','') )"
        )
        self.application = self.add("APPLICATION_CONTEXT('automotive design')")

    def add(self, entity: str) -> str:
        self.lines.append(f"#{len(self.lines) + 1}={entity};")
        return f"#{len(self.lines)}"

    def text(self) -> str:
        return _FRAME.format("\n".join(self.lines))

    # geometry

    def point(self, at: Sequence[float]) -> str:
        return self.add(f"CARTESIAN_POINT('',({','.join(map(_real, at))}))")

    def direction(self, along: Sequence[float]) -> str:
        return self.add(f"DIRECTION('',({','.join(map(_real, along))}))")

    def axes(
        self, at: Sequence[float] = (0, 0, 0), z: Point = (0, 0, 1), x: Point = (1, 0, 0)
    ) -> str:
        parts = self.point(at), self.direction(z), self.direction(x)
        return self.add(f"AXIS2_PLACEMENT_3D('',{','.join(parts)})")

    def vertex(self, at: Sequence[float]) -> str:
        return self.add(f"VERTEX_POINT('',{self.point(at)})")

    def _face(self, edges: Sequence[tuple[str, bool]], surface: str) -> str:
        ends = {True: ".T.", False: ".F."}
        oriented = [self.add(f"ORIENTED_EDGE('',*,*,{edge},{ends[same]})") for edge, same in edges]
        loop = self.add(f"EDGE_LOOP('',({','.join(oriented)}))")
        bound = self.add(f"FACE_OUTER_BOUND('',{loop},.T.)")
        return self.add(f"ADVANCED_FACE('',({bound}),{surface},.T.)")

    def _solid(self, faces: Sequence[str], name: str) -> str:
        shell = self.add(f"CLOSED_SHELL('',({','.join(faces)}))")
        return self.add(f"MANIFOLD_SOLID_BREP({_text(name)},{shell})")

    def box(self, size: Sequence[float], at: Sequence[float] = (0, 0, 0), name: str = "") -> str:
        """Add a box from `at`; return its solid."""
        corners = [np.array(at) + np.array(size) * [n & 1, n >> 1 & 1, n >> 2] for n in range(8)]
        vertices = [self.vertex(corner) for corner in corners]
        edges: dict[tuple[int, int], str] = {}
        faces = []
        for axis in range(3):
            low = [n for n in range(8) if not n >> axis & 1]
            a, b, c, d = low[0], low[1], low[3], low[2]
            for outward in (-1, 1):
                ring = [n | (1 << axis if outward > 0 else 0) for n in (a, b, c, d)]
                if (outward < 0) != (axis == 1):
                    ring.reverse()
                own = []
                for one, other in pairwise((*ring, ring[0])):
                    key = min(one, other), max(one, other)
                    if key not in edges:
                        way = corners[key[1]] - corners[key[0]]
                        length = np.linalg.norm(way)
                        vector = f"VECTOR('',{self.direction(way / length)},1.)"
                        line = f"LINE('',{self.point(corners[key[0]])},{self.add(vector)})"
                        ends = f"{vertices[key[0]]},{vertices[key[1]]}"
                        edges[key] = self.add(f"EDGE_CURVE('',{ends},{self.add(line)},.T.)")
                    own.append((edges[key], one < other))
                z = tuple(float(outward * (n == axis)) for n in range(3))
                x = tuple(float(n == (axis + 1) % 3) for n in range(3))
                plane = self.add(f"PLANE('',{self.axes(corners[ring[0]], z, x)})")
                faces.append(self._face(own, plane))
        return self._solid(faces, name)

    def cylinder(
        self, radius: float, height: float, at: Sequence[float] = (0, 0, 0), name: str = ""
    ) -> str:
        """Add a cylinder along z from `at`; return its solid."""
        x, y, z = at
        low, high = (self.vertex((x + radius, y, z + h)) for h in (0, height))
        circles = []
        for vertex, h in ((low, 0.0), (high, height)):
            circle = self.add(f"CIRCLE('',{self.axes((x, y, z + h))},{_real(radius)})")
            circles.append(self.add(f"EDGE_CURVE('',{vertex},{vertex},{circle},.T.)"))
        vector = self.add(f"VECTOR('',{self.direction((0, 0, 1))},1.)")
        line = self.add(f"LINE('',{self.point((x + radius, y, z))},{vector})")
        seam = self.add(f"EDGE_CURVE('',{low},{high},{line},.T.)")
        side = self.add(f"CYLINDRICAL_SURFACE('',{self.axes(at)},{_real(radius)})")
        down = self.add(f"PLANE('',{self.axes(at, (0, 0, -1))})")
        up = self.add(f"PLANE('',{self.axes((x, y, z + height))})")
        around = [(circles[0], True), (seam, True), (circles[1], False), (seam, False)]
        faces = [
            self._face(around, side),
            self._face([(circles[0], False)], down),
            self._face([(circles[1], True)], up),
        ]
        return self._solid(faces, name)

    # product structure

    def product(self, name: str, solids: Sequence[str] = ()) -> tuple[str, str]:
        """Add a product with solids, or an assembly; return its definition and representation."""
        context = self.add(f"PRODUCT_CONTEXT('',{self.application},'mechanical')")
        product = self.add(f"PRODUCT({_text(name)},{_text(name)},'',({context}))")
        formation = self.add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
        stage = self.add(
            f"PRODUCT_DEFINITION_CONTEXT('part definition',{self.application},'design')"
        )
        definition = self.add(f"PRODUCT_DEFINITION('design','',{formation},{stage})")
        shape = self.add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
        kind = "ADVANCED_BREP_SHAPE_REPRESENTATION" if solids else "SHAPE_REPRESENTATION"
        items = ",".join((self.axes(), *solids))
        representation = self.add(f"{kind}('',({items}),{self.context})")
        self.add(f"SHAPE_DEFINITION_REPRESENTATION({shape},{representation})")
        return definition, representation

    def place(
        self,
        part: tuple[str, str],
        assembly: tuple[str, str],
        at: Sequence[float],
        name: str = "",
        z: Point = (0, 0, 1),
        x: Point = (1, 0, 0),
    ) -> None:
        """Add an occurrence of a part in an assembly."""
        ends = f"{assembly[0]},{part[0]}"
        use = self.add(f"NEXT_ASSEMBLY_USAGE_OCCURRENCE({_text(name)},{_text(name)},'',{ends},$)")
        shape = self.add(f"PRODUCT_DEFINITION_SHAPE('','',{use})")
        axes = f"{self.axes()},{self.axes(at, z, x)}"
        transformation = self.add(f"ITEM_DEFINED_TRANSFORMATION('','',{axes})")
        relation = self.add(
            f"( REPRESENTATION_RELATIONSHIP('','',{part[1]},{assembly[1]}) "
            f"REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION({transformation}) "
            "SHAPE_REPRESENTATION_RELATIONSHIP() )"
        )
        self.add(f"CONTEXT_DEPENDENT_SHAPE_REPRESENTATION({relation},{shape})")


def box(size: Sequence[float], unit: str = "mm", name: str = "block") -> str:
    """Return a file of one box."""
    step = Step(unit)
    step.product(name, [step.box(size)])
    return step.text()


def assembly() -> str:
    """Return a file with two blocks, one of them rotated, and a pin inside a unit of two blocks."""
    step = Step()
    top, unit = step.product("top"), step.product("unit")
    block = step.product("block", [step.box((30, 20, 10))])
    pin = step.product("pin", [step.cylinder(5, 40)])
    step.place(block, unit, (0, 0, 0))
    step.place(block, unit, (50, 0, 0))
    step.place(unit, top, (0, 0, 0))
    step.place(unit, top, (0, 100, 0))
    step.place(pin, top, (0, 0, 100))
    return step.text()
