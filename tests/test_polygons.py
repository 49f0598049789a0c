"""Polygons in mesh files, cut into triangles that fill them."""

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh

from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.polygons import cut_into_triangles, folded
from packit_sim.libraries.mesh_files import read
from packit_sim.libraries.obj_faces import MAX_CORNERS, simple_faces

ARROW = ((0, 0), (2, 1), (0, 2), (1, 1))
LETTER = ((0, 0), (3, 0), (3, 1), (1, 1), (1, 2), (3, 2), (3, 3), (0, 3))
COLLINEAR = ((0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (2, 1), (2, 3), (1, 3), (1, 1), (0, 1))


def spiral(turns: float, points: int) -> list[tuple[float, float]]:
    angles = np.linspace(0, 2 * np.pi * turns, points)
    out, back = (
        np.column_stack([(angles + r) * np.cos(angles), (angles + r) * np.sin(angles)])
        for r in (1.0, 0.5)
    )
    return np.concatenate([out, back[::-1]]).tolist()


def star(corners: int, seed: int) -> list[tuple[float, float]]:
    rng = np.random.default_rng(seed)
    angles = 2 * np.pi * (np.arange(corners) + 0.9 * rng.random(corners)) / corners
    radii = rng.uniform(0.1, 1, corners)
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles)]).tolist()


OUTLINES = {
    "arrow": ARROW,
    "letter": LETTER,
    "letter from another corner": LETTER[3:] + LETTER[:3],
    "letter clockwise": LETTER[::-1],
    "with corners on its edges": COLLINEAR,
    "spiral": spiral(3, 100),
    **{f"star {seed}": star(5 + 3 * seed, seed) for seed in range(6)},
}


def area(outline: Floats) -> float:
    x, y = outline.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


@pytest.mark.parametrize("name", OUTLINES)
def test_triangles_fill_a_polygon_in_any_plane(name) -> None:
    outline = np.array(OUTLINES[name], dtype=float)
    turn = trimesh.transformations.random_rotation_matrix(np.random.default_rng(1).random(3))
    corners = np.column_stack([outline, np.zeros(len(outline))]) @ turn[:3, :3].T + (1, 2, 3)
    triangles = cut_into_triangles(corners)
    assert triangles.shape == (len(outline) - 2, 3)
    areas = np.array([area(triangle) for triangle in outline[triangles]])
    assert (areas * np.sign(area(outline)) > -1e-12).all()
    assert areas.sum() == pytest.approx(area(outline))
    edges = np.sort(trimesh.geometry.faces_to_edges(triangles), axis=1)
    pairs, counts = np.unique(edges, axis=0, return_counts=True)
    rim = np.sort([(n, (n + 1) % len(outline)) for n in range(len(outline))], axis=1)
    assert {tuple(pair) for pair in pairs[counts == 1].tolist()} == {tuple(p) for p in rim.tolist()}


def test_a_fan_is_folded_if_it_leaves_the_polygon() -> None:
    flat = lambda outline: np.array([(x, y, 0.0) for x, y in outline])  # noqa: E731
    assert folded(np.array([flat(LETTER), flat(LETTER[::-1])])).tolist() == [True, True]
    assert folded(np.array([flat(ARROW), flat(ARROW[1:] + ARROW[:1])])).tolist() == [True, False]
    convex = [(math.cos(a), math.sin(a)) for a in np.linspace(0, 6, 9)]
    assert not folded(flat(convex)[None]).any()


def prism(outline: tuple[tuple[int, int], ...], texture: str = "", end: str = "\n") -> bytes:
    """The OBJ text of an upright prism: two polygons, and a quad for each side."""
    n = len(outline)
    corner = lambda number: f"{number}{texture}"  # noqa: E731
    lines = [f"v {x} {y} {z}" for z in (0, 1) for x, y in outline]
    lines.append("vn 0 0 1")
    lines.append("f " + " ".join(corner(k) for k in range(n, 0, -1)) + " # the bottom")
    lines.append("  f " + " ".join(corner(k) for k in range(-n, 0)))
    for k in range(n):
        after = (k + 1) % n
        lines.append("f " + " ".join(map(corner, (k + 1, after + 1, after + n + 1, k + n + 1))))
    return (end.join(lines) + end).encode()


@pytest.mark.parametrize("texture", ["", "//1"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_prism_with_a_polygon_that_is_not_convex_is_read(texture, end, tmp_path: Path) -> None:
    for outline in (LETTER, COLLINEAR, ARROW):
        (tmp_path / "prism.obj").write_bytes(prism(outline, texture, end))
        mesh = read(tmp_path / "prism.obj").mesh
        mesh.merge_vertices(merge_norm=True, merge_tex=True)
        around = sum(
            math.dist(p, q) for p, q in zip(outline, outline[1:] + outline[:1], strict=True)
        )
        whole = area(np.array(outline, dtype=float))
        assert mesh.volume == pytest.approx(whole)
        assert mesh.area == pytest.approx(2 * abs(whole) + around)
        assert mesh.is_watertight


def test_text_simple_faces_is_not_changed() -> None:
    def plain(outline: tuple[tuple[int, int], ...]) -> bytes:
        n = len(outline)
        last, first = (
            " ".join(map(str, numbers)).encode()
            for numbers in (range(-n, 0), range(n + 1, 2 * n + 1))
        )
        return prism(outline).replace(b" # the bottom", b"").replace(last, first)

    box = plain(((0, 0), (1, 0), (1, 1), (0, 1)))
    many = plain(tuple(tuple(p) for p in spiral(4, MAX_CORNERS)))  # type: ignore[arg-type]
    broken = (
        b"f 1 2 3 4\n",
        b"v 0 0\nf 1 2 3 4 5\n",
        b"v 0 0 0\nf 1 2 3 x\n",
        b"f 9 9 9 9\nv a b c",
    )
    for text in (box, many, *broken, b"", b"v 0 0 0\nf 1 1 1\n"):
        assert simple_faces(text) == text
