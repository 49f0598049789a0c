"""More bricks in a container: depths decide rightly, and known packings are found."""

from collections.abc import Sequence

import fcl
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from packit_sim import (
    BoxContainer,
    ItemType,
    Limits,
    MeshContainer,
    PackSettings,
    Part,
    pack,
)
from packit_sim.geometry.motions import Motion
from packit_sim.parts import check
from packit_sim.parts.filling.brick_kernels import separated
from packit_sim.parts.filling.brick_windows import Brick, BrickWindows
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement
from packit_sim.parts.reading.boxes import BoxType

HALF = np.array((2.0, 1.0, 0.5))

NO_WALLS = np.empty((0, 3, 3))

FAR = np.full(3, 1000.0)


def are_apart(
    centres: Sequence[object], axes: Sequence[object], walls: np.ndarray = NO_WALLS
) -> bool:
    """Return whether bricks are apart, which ends a search before its first move."""
    bricks = np.array(centres, float), np.array(axes, float), np.array([HALF] * 3)
    space = np.zeros((1, 1, 1), bool), 1000.0
    given = bricks, 1, (np.zeros(3), FAR), np.eye(3)[None], (walls, FAR), space, False
    before = bricks[0].copy()
    found = bool(separated(*given, 1, np.zeros(1, np.uint64)))
    assert not found or (bricks[0] == before).all()
    return found


def turns(count: int, seed: int) -> np.ndarray:
    return Rotation.random(count, np.random.default_rng(seed)).as_matrix()


def test_bricks_are_apart_where_another_library_says_so() -> None:
    rng = np.random.default_rng(0)
    both = [0, 0]
    for one, other in zip(turns(400, 1), turns(400, 2), strict=True):
        way = rng.normal(0, 1.4, 3)
        shapes = [
            fcl.CollisionObject(fcl.Box(*2 * HALF), fcl.Transform(turn.T, place))
            for turn, place in ((one, np.zeros(3)), (other, way))
        ]
        is_apart = fcl.collide(*shapes, fcl.CollisionRequest(), fcl.CollisionResult()) == 0
        assert are_apart([FAR / 2, FAR / 2 + way], [one, other]) == is_apart
        both[is_apart] += 1
    assert min(both) > 80


def test_a_brick_is_clear_of_a_wall_where_another_library_says_so() -> None:
    rng = np.random.default_rng(0)
    both = [0, 0]
    for turn in turns(400, 3):
        corners = rng.normal(0, 2, (3, 3)) + rng.normal(0, 1, 3)
        wall = fcl.BVHModel()
        wall.beginModel(3, 1)
        wall.addSubModel(corners, np.array([[0, 1, 2]]))
        wall.endModel()
        brick = fcl.CollisionObject(fcl.Box(*2 * HALF), fcl.Transform(turn.T, np.zeros(3)))
        request, result = fcl.CollisionRequest(), fcl.CollisionResult()
        is_clear = fcl.collide(brick, fcl.CollisionObject(wall), request, result) == 0
        assert are_apart([FAR / 2], [turn], corners[None] + FAR / 2) == is_clear
        both[is_clear] += 1
    assert min(both) > 80


@pytest.mark.parametrize(("place", "is_inside"), [((2, 1, 0.5), True), ((1.9, 1, 0.5), False)])
def test_a_brick_is_within_the_sides_of_the_space(place: object, is_inside: bool) -> None:
    assert are_apart([place], [np.eye(3)]) == is_inside


def test_equal_orientations_of_a_brick_are_tried_once() -> None:
    def orientations(sides: tuple[float, ...], rotations: str) -> tuple[int, int]:
        mesh = trimesh.creation.box(sides)
        brick = Brick.of(ItemType("brick", mesh.vertices, mesh.faces, rotations=rotations))
        assert brick is not None
        return len(brick.axes), brick.usual

    assert orientations((4, 2, 1), "cube") == (6, 6)
    assert orientations((2, 2, 1), "cube") == (3, 3)
    assert orientations((4, 2, 1), "yaw-4") == (2, 2)
    assert orientations((4, 2, 1), "fixed") == (1, 1)
    ball = trimesh.creation.icosphere(1)
    assert Brick.of(ItemType("ball", ball.vertices, ball.faces)) is None


def bricks(*sides: float, rotations: str = "cube", count: int = 100) -> Part:
    return Part("brick", trimesh.creation.box(sides), count, rotations=rotations)


def searched(
    part: Part,
    box: object,
    places: Sequence[Sequence[float]],
    windows: int = 400,
    seed: int = 0,
    **settings: object,
) -> list[Packing]:
    """Search from bricks at places (x, y, z) and turns (degrees); return all that are found."""
    own = PackSettings(workers=1, iterations=1, **settings)
    task = pack([part], box, "count", settings=own).task
    turned = [(Rotation.from_euler("z", angle, degrees=True), place) for *place, angle in places]
    poses = [Motion(turn.as_matrix().round(9), np.array(place)) for turn, place in turned]
    found = [task.packing(task.container(task.boxes[0]), [Placement(0, each) for each in poses])]
    assert not found[0].problems()
    search = BrickWindows(task, task.boxes[0], {0: part.count}, (), seed)
    assert search.is_possible
    search.run(found[0], windows, lambda: False, found.append)
    assert not any(each.problems() for each in found)
    return found


def counts(packings: Sequence[Packing]) -> list[int]:
    return [len(each.placements) for each in packings]


PINWHEEL = 5.0, 5.0, 1.0
"""Four bricks of 3 x 2 around an empty square; lattices hold three."""

THREE = (1.5, 1, 0.5, 0), (1.5, 3, 0.5, 0), (4, 1.5, 0.5, 90)


def test_bricks_form_a_pinwheel() -> None:
    assert counts(searched(bricks(3, 2, 1, count=4), PINWHEEL, THREE)) == [3, 4]


def test_there_are_no_more_bricks_than_asked_for() -> None:
    assert counts(searched(bricks(3, 2, 1, count=3), PINWHEEL, THREE[:2])) == [2, 3]


def test_fixed_rotations_do_not_form_a_pinwheel() -> None:
    part = bricks(3, 2, 1, rotations="fixed", count=4)
    assert counts(searched(part, PINWHEEL, THREE[:2], 60)) == [2]


def test_bricks_lean_where_that_gives_space_to_one_more() -> None:
    size = 2.78, 2.78, 1.02  # five squares: the least side is 2 + 1 / sqrt(2) = 2.71
    four = [(x, y, 0.5, 0) for x in (0.5, 1.5) for y in (0.5, 1.5)]
    assert counts(searched(bricks(1, 1, 1, count=5), size, four, 30)) == [4]
    part = bricks(1, 1, 1, rotations="free", count=5)
    assert counts(searched(part, size, four)) == [4, 5]


def test_bricks_keep_their_distances() -> None:
    far = [(1.1 * x + 0.1, 1.1 * y + 0.1, 0.5, angle) for x, y, _, angle in THREE]
    given = bricks(3, 2, 1, count=4), (5.6, 5.6, 1.0), far
    found = searched(*given, clearance=0.2)
    assert counts(found) == [3, 4]
    assert least_distance(found[-1]) >= 0.2 - 1e-6


def test_bricks_that_have_little_space_keep_all_of_the_clearance() -> None:
    three = [(1.5, 1, 0.5, 0), (1.5, 3.2, 0.5, 0), (4.2, 1.5, 0.5, 90)]
    found = searched(bricks(3, 2, 1, count=4), (5.2, 5.2, 1.0), three, clearance=0.2)
    assert counts(found) == [3, 4]
    assert least_distance(found[-1]) >= 0.2 - 1e-6


def least_distance(packing: Packing) -> float:
    manager = trimesh.collision.CollisionManager()
    for number, one in enumerate(packing.placements):
        mesh = trimesh.Trimesh(packing.vertices(one), packing.types[0].faces)
        manager.add_object(str(number), mesh)
    return float(manager.min_distance_internal())


def test_the_same_seed_finds_the_same_bricks() -> None:
    given = bricks(3, 2, 1, count=4), PINWHEEL, THREE
    one, same, other = (searched(*given, seed=seed)[-1].placements for seed in (0, 0, 1))
    assert one == same != other


@pytest.mark.parametrize("angle", [0.4, 1.2])
def test_bricks_stay_inside_slanted_walls(angle: float) -> None:
    mesh = trimesh.creation.box((5.02, 5.02, 1.01))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(angle, (0, 0, 1)))
    container = MeshContainer(ItemType("case", mesh.vertices, mesh.faces), name="case")
    part = bricks(3, 2, 1, rotations="free", count=4)
    packed = pack([part], container, "count", settings=PackSettings(workers=1, iterations=400))
    assert packed.count == 4
    assert not check(packed).problems


def test_bricks_go_around_an_obstacle() -> None:
    mesh = trimesh.creation.box((0.98, 0.98, 1))
    mesh.apply_translation((2.5, 2.5, 0.5))
    block = ItemType("block", mesh.vertices, mesh.faces)
    settings = PackSettings(workers=1, iterations=400)
    part, box = bricks(3, 2, 1, count=4), BoxContainer(PINWHEEL, (block,))
    assert pack([part], box, "count", settings=settings).count == 4


@pytest.mark.parametrize(
    ("parts", "limits"),
    [
        ([bricks(3, 2, 1)], Limits(max_parts=2)),
        ([bricks(3, 2, 1), bricks(1, 1, 1)], Limits()),
        ([Part("ball", trimesh.creation.icosphere(1), 9)], Limits()),
    ],
)
def test_what_is_more_than_equal_bricks_is_left_to_the_nester(
    parts: list[Part], limits: Limits
) -> None:
    box = BoxType((5, 5, 5), limits=limits)
    task = pack(parts, box, "count", settings=PackSettings(workers=1, iterations=1)).task
    assert not BrickWindows(task, box, dict.fromkeys(range(len(parts)), 1), (), 0).is_possible
