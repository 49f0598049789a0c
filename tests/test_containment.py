"""A part of one item's surface inside a closed part of another's: no cell may show it."""

import numpy as np
import pytest
import trimesh
from trimesh import creation

from packit_sim import placement
from packit_sim.box import Box
from packit_sim.core.errors import InfeasibleError
from packit_sim.engine import insertion, nofit
from packit_sim.engine.collision import collides, contains
from packit_sim.engine.collision_meshes import CollisionMesh
from packit_sim.engine.containment_kernels import winding_number
from packit_sim.engine.nofit import MEETINGS_BEFORE_TABLE
from packit_sim.engine.occupancy import Occupancy
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import CONTACT_TOLERANCE
from packit_sim.geometry.parts import Parts
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.placement import PlacedItem, PosedItem
from tests.zoo import BALL, HOLLOW, RING, TILTED, item_of, nested_pair

CELLS = (32, 32, 32)
"""Cells of a small box, for the oracle."""

PLATE = item_of(creation.box((0.3, 0.2, 0.0045)))
SHEET = item_of(creation.box((0.21, 0.11, 0.0015)))


def solid_angle(triangles: np.ndarray, point: np.ndarray) -> float:
    """The winding number by solid angles (van Oosterom and Strackee, 1983)."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    rest = la * lb * lc
    for one, other, length in ((a, b, lc), (b, c, la), (c, a, lb)):
        rest = rest + np.einsum("ij,ij->i", one, other) * length
    return float(np.arctan2(volume, rest).sum() / (2 * np.pi))


def shared_depth(one: PlacedItem, other: PlacedItem) -> float:
    """Mean thickness of what two solids share: twice its volume over its area, in box units."""
    solids = [
        trimesh.Trimesh(p.vertices, p.item.shape.mesh.faces, process=False) for p in (one, other)
    ]
    shared = trimesh.boolean.intersection(solids, engine="manifold")
    return 0.0 if shared.is_empty or shared.area == 0 else 2 * abs(shared.volume) / shared.area


@pytest.mark.parametrize("rotation", range(rotations.COUNT))
def test_a_sheet_in_a_thicker_sheet_is_not_feasible(rotation: int) -> None:
    plate, sheet = PLATE.turned(rotation), SHEET.turned(rotation)
    shift = [round((own - its) / 8) for own, its in zip(plate.cells, sheet.cells, strict=True)]
    for first, second, step in ((plate, sheet, 1), (sheet, plate, -1)):
        box = Box()
        box.place(first, (5, 5, 5))
        location = tuple(5 + step * n for n in shift)
        there = PlacedItem(second, location)
        assert not collides(box.placed[0], there) and contains(box.placed[0], there)
        assert not box.feasible(second)[location]
        assert not placement.is_valid(box.cells, box.placed, there)
        assert box.why_not(second, location).items == (0,)
        with pytest.raises(InfeasibleError):
            box.place(second, location)


def test_no_search_puts_a_sheet_into_another() -> None:
    box = Box(CELLS)
    box.place(PLATE, (0, 0, 0))
    for _ in range(MEETINGS_BEFORE_TABLE + 3):  # without tables, and with them
        assert (box.feasible(SHEET) == placement.oracle(box, SHEET)).all()
    union = np.any([placement.oracle(box, SHEET.turned(n)) for n in range(24)], axis=0)
    assert (box.feasible_in_any(SHEET) == union).all()
    location = box.blbf(SHEET)
    assert location == placement.first(placement.oracle(box, SHEET)) == (0, 5, 0)
    kinematic = Box(CELLS, kinematic=True)
    kinematic.place(SHEET, (1, 1, 1))
    mask = kinematic.feasible(PLATE)
    for at in np.argwhere(placement.oracle(kinematic, PLATE)).tolist():
        candidate = PlacedItem(PLATE, tuple(at))
        assert mask[candidate.location] == insertion.is_insertable_oracle(
            kinematic.placed, candidate
        )


@pytest.mark.parametrize("seed", range(30))
def test_nested_surfaces_are_judged_as_by_the_oracle(seed: int) -> None:
    check_nested(np.random.default_rng(seed))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30, 660))
def test_many_nested_surfaces_are_judged_as_by_the_oracle(seed: int) -> None:
    check_nested(np.random.default_rng(seed))


def check_nested(rng: np.random.Generator) -> None:
    """Compare masks, tables and solids of two items, either of which is in the box."""
    pair = nested_pair(rng)
    closed = all(item.shape.mesh.is_volume for item in pair)
    for first, second in (pair, pair[::-1]):
        box = Box(CELLS)
        if not (placement.fits(CELLS, first) and placement.fits(CELLS, second)):
            continue
        box.place(first, rng.choice(np.argwhere(box.feasible(first))))
        truth = placement.oracle(box, second)
        assert (box.feasible(second) == truth).all()
        assert box.blbf(second) == placement.first(truth)
        for location in [tuple(at) for at in np.argwhere(truth).tolist()]:
            candidate = PlacedItem(second, location)
            near = np.abs(candidate.center - box.placed[0].center)
            if closed and (near < (first.extents + second.extents) / 2).all():
                assert shared_depth(box.placed[0], candidate) <= CONTACT_TOLERANCE
        table = nofit.NoFit(*sorted((first, second), key=lambda item: item.key))
        for location in np.ndindex(truth.shape):
            candidate = PlacedItem(second, location)
            if placement.is_inside(CELLS, candidate):
                assert table.conflict(box.placed[0], candidate) is not bool(truth[location])


def test_the_generated_pairs_are_nested_often_enough_to_test_something() -> None:
    inside = 0
    for seed in range(30):
        outer, inner = nested_pair(np.random.default_rng(seed))
        placed = PlacedItem(outer, (8, 8, 8))
        for location in np.ndindex(6, 6, 6):
            candidate = PlacedItem(inner, tuple(int(n) + 7 for n in location))
            inside += not collides(placed, candidate) and contains(placed, candidate)
    assert inside >= 20


@pytest.mark.parametrize("seed", range(20))
def test_items_off_the_grid_are_judged_as_by_the_oracle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    outer, inner = nested_pair(rng)
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))
    for first, second in ((outer, inner), (inner, outer)):
        middle = PlacedItem(second, (3, 3, 3))
        matrix = middle.matrix if seed % 2 else turn @ middle.matrix
        matrix[:3, 3] = middle.center
        matrix[:3, :3] *= np.cbrt(first.scale / second.scale)
        occupancy: Occupancy[PosedItem] = Occupancy(CELLS)
        occupancy.add(PosedItem(first, matrix))
        found = placement.feasible(occupancy, second)
        assert (found == placement.oracle(occupancy, second)).all()


def test_a_sheet_is_inside_one_that_is_off_the_grid() -> None:
    tilt = trimesh.transformations.rotation_matrix(0.004, (1, 0, 0))
    there = PlacedItem(SHEET, (3, 3, 3))
    for item, held in ((PLATE, SHEET), (SHEET, PLATE)):
        matrix = np.eye(4)
        matrix[:3, :3] = tilt[:3, :3] * np.cbrt(item.scale)
        matrix[:3, 3] = PlacedItem(held, there.location).center
        occupancy: Occupancy[PosedItem] = Occupancy(CELLS)
        occupancy.add(PosedItem(item, matrix))
        assert not placement.is_feasible(occupancy, PlacedItem(held, there.location))
        assert placement.conflicts(PlacedItem(held, there.location), occupancy.placed[0])


def test_an_open_part_holds_what_a_closed_one_does_not() -> None:
    open_plate = creation.box((0.3, 0.2, 0.0045))
    open_plate.update_faces(np.arange(12) > 0)
    for mesh, feasible in ((open_plate, True), (creation.box((0.3, 0.2, 0.0045)), False)):
        box = Box(CELLS)
        box.place(item_of(mesh), (0, 0, 0))
        assert box.feasible(SHEET)[1, 1, 0] == feasible


def test_each_part_is_looked_at_and_the_winding_of_a_closed_one_may_be_either() -> None:
    """The second part alone is inside, and the closed part faces inwards."""
    inverted = creation.box((0.3, 0.2, 0.0045))
    inverted.invert()
    far = creation.box((0.02, 0.02, 0.004))
    far.apply_translation((0.2, 0, 0))
    host = item_of(trimesh.util.concatenate([inverted, far]))
    apart = creation.box((0.01, 0.01, 0.001))
    apart.apply_translation((0, 0.15, 0))
    guest = item_of(trimesh.util.concatenate([apart, creation.box((0.01, 0.01, 0.001))]))
    placed = PlacedItem(host, (5, 5, 5))
    found = [
        not collides(placed, candidate) and contains(placed, candidate)
        for location in np.ndindex(12, 12, 4)
        for candidate in [PlacedItem(guest, tuple(int(n) + 3 for n in location))]
    ]
    assert any(found) and not all(found)


def test_what_is_in_a_cavity_is_inside_as_it_is_by_cells() -> None:
    """The same answer for a cavity that has inner cells, and for one that is too thin for them."""
    cavity = creation.box((0.28, 0.18, 0.0035))
    cavity.invert()
    folder = item_of(trimesh.util.concatenate([creation.box((0.3, 0.2, 0.0045)), cavity]))
    for host, guest in ((folder, SHEET), (Item(HOLLOW, 0.3), Item(BALL, 0.0002))):
        box = Box((64, 64, 64))
        box.place(host, (0, 0, 0))
        middle = tuple((own - its) // 8 for own, its in zip(host.cells, guest.cells, strict=True))
        assert not collides(box.placed[0], PlacedItem(guest, middle))
        assert not box.feasible(guest)[middle]
        assert placement.conflicts(box.placed[0], PlacedItem(guest, middle))


@pytest.mark.parametrize("shape", [BALL, RING, TILTED, PLATE.shape, HOLLOW])
def test_winding_numbers_equal_solid_angles(shape: Shape) -> None:
    rng = np.random.default_rng(0)
    triangles = np.asarray(shape.mesh.triangles)
    inside = 0
    for point in rng.uniform(-0.6, 0.6, (400, 3)) * shape.extents:
        expected = solid_angle(triangles, point)
        assert winding_number(triangles, point) == pytest.approx(expected, abs=1e-6)
        inside += expected > 0.5
    assert 40 < inside < 360


def test_winding_numbers_are_exact_where_edges_and_corners_are_straight_above() -> None:
    """All of these rays meet edges, corners, or upright faces."""
    ball, block = creation.icosphere(subdivisions=2), creation.box((2, 2, 2))
    for mesh in (ball, block):
        triangles = np.asarray(mesh.triangles)
        for x, y, _ in mesh.vertices:
            for corner in (0.5, 0.25):
                point = np.array([x * corner, y * corner, 0.1])
                assert winding_number(triangles, point) == 1
            assert winding_number(triangles, np.array([x, y, -3.0])) == 0
    across = np.linspace(-0.75, 0.75, 7)
    for x in across:
        assert winding_number(np.asarray(block.triangles), np.array([x, x, x])) == 1
        assert winding_number(np.asarray(block.triangles), np.array([x, -x, 1.5])) == 0


@pytest.mark.parametrize("turned", range(3))
def test_a_slanted_triangle_is_above_only_what_is_below_its_plane(turned: int) -> None:
    """Far from the origin, so that no other coordinate passes for a height."""
    corners = np.array([[9.0, 9.0, 0.0], [12.0, 9.0, 3.0], [9.0, 12.0, 3.0], [9.0, 9.0, 4.0]])
    faces = [(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)]
    triangles = np.roll(corners[faces], turned, axis=1)
    for x, y in ((9.5, 9.5), (10.0, 9.5), (9.25, 10.5)):
        floor = x + y - 18.0  # the plane through the first three corners
        assert winding_number(triangles, np.array([x, y, floor - 0.1])) == 0
        assert abs(winding_number(triangles, np.array([x, y, floor + 0.1]))) == 1


def test_parts_of_a_surface() -> None:
    """A closed part, an open one, and one whose winding is not consistent."""
    meshes = [creation.box((1, 1, 1)) for _ in range(4)]
    for n, mesh in enumerate(meshes):
        mesh.apply_translation((2 * n, 0, 0))
    meshes[1].update_faces(np.arange(12) > 0)
    meshes[2].faces[0] = meshes[2].faces[0, ::-1]
    mesh = trimesh.util.concatenate(meshes)
    vertices = np.asarray(mesh.vertices)
    parts = Parts.of(vertices, np.asarray(mesh.faces))
    distances = np.linalg.norm(vertices, axis=1)
    assert sorted((parts.vertices // 8).tolist()) == [0, 1, 2, 3]
    for farthest in parts.vertices.tolist():
        first = farthest // 8 * 8
        assert distances[farthest] == distances[first : first + 8].max()
    assert parts.starts.tolist() == [0, 12, 24]
    assert sorted({int(v) // 8 for v in parts.closed.ravel()}) == [0, 3]
    soup = trimesh.Trimesh(
        np.random.default_rng(0).random((9, 3)), [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    )
    alone = Parts.of(np.asarray(soup.vertices), np.asarray(soup.faces))
    assert len(alone.vertices) == 3 and len(alone.closed) == 0 and alone.shells == []
    assert alone.starts.tolist() == [0]
    arrays = CollisionMesh(Shape.from_mesh(soup, "soup"), 1.0).parts
    assert len(arrays.triangles) == 0 and arrays.points.shape == (3, 3)
