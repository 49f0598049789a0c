"""Contents of pictures: cameras, layouts, cuts, panes, colours, depth; and failures."""

from __future__ import annotations

import dataclasses
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

from packit_sim.box import Box
from packit_sim.core.errors import RenderError
from packit_sim.geometry.lattice import CELL, FINE
from packit_sim.geometry.shapes import Item
from packit_sim.placement import BoxState, PlacedItem
from packit_sim.render import bullet, rendering
from packit_sim.render.cameras import CAMERAS, FRONT, TOP, Camera, turntable
from packit_sim.render.coloring import ByNumber, ByShare, by_order
from packit_sim.render.defaults import BACKGROUND
from packit_sim.render.layouts import ITEM_GAP, Layout
from packit_sim.render.looks import Cut, Look
from packit_sim.render.sections import is_beyond, section
from packit_sim.render.software import SoftwareWorld
from packit_sim.scene import Scene
from tests.examples import OFTEN_OPENED
from tests.watched import Watched
from tests.zoo import BALL, BOWL, CUBE, HOLLOW, RING, ZOO, cube_of

pytestmark = pytest.mark.usefixtures("software")

SIDE = 120
CENTRE = np.full(3, 0.5)


def three_cubes() -> Box:
    """Cubes of 30 cells, low left behind, low right in front, and above the first."""
    box = Box()
    for location in ((0, 0, 0), (16, 16, 0), (0, 0, 16)):
        box.place(cube_of(30), location)
    return box


def corners(size: np.ndarray) -> np.ndarray:
    return np.indices((2, 2, 2)).reshape(3, 8).T * size


def seen(projection: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n, 2) columns and rows of points."""
    homogeneous = np.column_stack((points, np.ones(len(points)))) @ projection.T
    return homogeneous[:, :2] / homogeneous[:, 2:]


def points_of(shot: rendering.Snapshot) -> np.ndarray:
    """(n, 3) where what the picture shows is, from its depth alone."""
    rows, columns = np.nonzero(np.isfinite(shot.depth))
    depth = shot.depth[rows, columns].astype(float)
    rays = np.stack((columns + 0.5, rows + 0.5, np.ones(len(rows)))) * depth
    return np.linalg.solve(shot.projection[:, :3], rays - shot.projection[:, 3:]).T


@given(
    azimuth=st.floats(-720, 720),
    elevation=st.floats(-89, 89),
    fov=st.floats(5, 120),
    size=st.tuples(*[st.floats(0.1, 5)] * 3),
    aspect=st.floats(0.3, 3),
)
def test_a_camera_sees_all_that_it_is_to_frame(azimuth, elevation, fov, size, aspect) -> None:
    camera, points = Camera(azimuth, elevation, fov), corners(np.array(size))
    height = 200
    width = round(height * aspect)
    at = seen(camera.projection(camera.eye(points, width / height), width, height), points)
    assert (at > 0).all() and (at < (width, height)).all()
    touched = np.concatenate((at / (width, height), 1 - at / (width, height)))
    assert touched.min() == pytest.approx(camera.margin / 2, abs=1e-6)


def test_where_the_cameras_with_names_look_from() -> None:
    assert CAMERAS["front"].toward @ (0, 1, 0) > 0.99 and CAMERAS["top"].toward[2] > 0.99
    assert CAMERAS["iso"].toward.min() > 0.3
    round_trip = turntable(8)
    assert round_trip[0] == CAMERAS["iso"] and len({c.elevation for c in round_trip}) == 1
    assert {c.azimuth for c in round_trip} == {62.0 + 45 * n for n in range(8)}


@pytest.mark.parametrize("camera", [Camera(), FRONT, TOP, Camera(200, -30, 60)])
def test_depth_and_projection_lead_back_to_the_surfaces(camera: Camera, renderer: str) -> None:
    with Scene(three_cubes()) as scene:
        shot = scene.snapshot(SIDE, SIDE - 20, Look(camera, box="none"))
        placed = three_cubes().placed
    found = points_of(shot)
    owner = shot.segmentation[np.isfinite(shot.depth)]
    assert set(owner.tolist()) >= {0, 1} or camera is TOP
    for n in set(owner.tolist()):
        away = np.abs(np.abs(found[owner == n] - placed[n].center).max(axis=1) - 0.15)
        assert np.quantile(away, 0.9) < 0.01


@pytest.mark.parametrize("name", ["front", "top"])
def test_what_is_near_hides_what_is_far(name: str) -> None:
    with Scene(three_cubes()) as scene:
        shot = scene.snapshot(SIDE, SIDE, Look(CAMERAS[name]))
    counts = [np.count_nonzero(shot.segmentation == n) for n in range(3)]
    if name == "front":  # the one in front is as large as the others, and nearer
        assert counts[1] > 1.1 * counts[0] > counts[2] > 0
    else:  # one stands on the other
        assert counts[0] < 0.25 * counts[2] and counts[1] < counts[2]


@given(factor=st.floats(0, 5), seed=st.integers(0, 99))
def test_exploded_items_keep_their_directions(factor: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    items = [Item(shape, 0.01) for shape in (CUBE, BALL, RING)]
    places = rng.integers(0, 20, (3, 3)).tolist()
    placed = [PlacedItem(item, tuple(at)) for item, at in zip(items, places, strict=True)]
    size = np.ones(3)
    packed, apart = (Layout.packed(placed, size, f) for f in (0.0, factor))
    for one, two in ((0, 1), (1, 2), (0, 2)):
        before = packed.poses[one].translation - packed.poses[two].translation
        after = apart.poses[one].translation - apart.poses[two].translation
        assert np.allclose(after, (1 + factor) * before)
    assert all(
        pose.translation[2] >= p.item.extents[2] / 2 - 1e-9
        for pose, p in zip(apart.poses, placed, strict=True)
    )


def test_exploded_items_are_all_in_the_picture() -> None:
    box = three_cubes()
    with Scene(box) as scene:
        shot = scene.snapshot(SIDE, SIDE, Look(explode=2.0))
    shown = np.isfinite(shot.depth)
    assert set(np.unique(shot.segmentation)) == {-1, 0, 1, 2}
    assert not (shown[[0, -1]].any() or shown[:, [0, -1]].any())


@given(
    count=st.integers(0, 30),
    seed=st.integers(0, 99),
    size=st.sampled_from([None, np.array((1.0, 1.0, 1.0)), np.array((2.0, 0.4, 1.0))]),
)
def test_items_are_apart_on_the_floor_next_to_the_box(count, seed, size) -> None:
    rng = np.random.default_rng(seed)
    items = [Item(ZOO[rng.integers(len(ZOO))], rng.uniform(0.01, 0.5)) for _ in range(count)]
    layout = Layout.standing(items, size)
    extents = np.array([item.extents for item in items]).reshape(-1, 3)
    centers = np.array([pose.translation for pose in layout.poses]).reshape(-1, 3)
    assert np.allclose(centers[:, 2], extents[:, 2] / 2)
    if size is not None:
        assert (centers[:, 0] - extents[:, 0] / 2 >= size[0] + ITEM_GAP).all()
    for n in range(count):
        gaps = np.abs(centers - centers[n])[:, :2] - (extents + extents[n])[:, :2] / 2
        gaps[n] = np.inf
        assert (gaps.max(axis=1) >= ITEM_GAP - 1e-9).all()


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_the_section_of_a_cube_is_a_square_at_the_cut(axis: str) -> None:
    placed = PlacedItem(cube_of(30), (5, 5, 5))
    cut = Cut(axis, 0.3501)  # type: ignore[arg-type]
    left = section(placed, cut)
    assert left is not None
    along = np.asarray(left.cap.vertices)[:, cut.dimension] + placed.center[cut.dimension]
    assert np.allclose(along, 0.35)
    assert left.cap.area == pytest.approx(0.09, rel=0.03)
    low, high = left.rest.bounds + placed.center
    assert high[cut.dimension] == pytest.approx(0.35)
    assert np.allclose(np.delete(high - low, cut.dimension), 0.3) and np.allclose(low, 0.2)


def test_sections_by_hand() -> None:
    ball = PlacedItem(Item(BALL, 0.1), (4, 4, 0))
    middle = section(ball, Cut("z", float(ball.center[2])))
    radius = float(ball.item.extents[0]) / 2
    assert middle is not None
    assert middle.cap.area == pytest.approx(np.pi * radius**2, rel=0.05)
    hollow = PlacedItem(Item(HOLLOW, 0.5), (0, 0, 0))
    through = section(hollow, Cut("y", float(hollow.center[1])))
    width = float(hollow.item.extents[0])
    assert through is not None  # a cavity that nothing can get into counts as solid
    assert through.cap.area == pytest.approx(width**2, rel=0.03)
    bowl = PlacedItem(Item(BOWL, 0.5), (0, 0, 0))
    wall = section(bowl, Cut("y", float(bowl.center[1])))
    assert wall is not None
    curve = np.pi * float(bowl.item.extents[0]) / 2
    assert 0.5 * curve * FINE < wall.cap.area < 3 * curve * FINE


@given(at=st.floats(0.01, 1.2), which=st.integers(0, len(ZOO) - 1), axis=st.sampled_from("xyz"))
def test_an_item_is_kept_cut_or_gone(at: float, which: int, axis: str) -> None:
    placed = PlacedItem(Item(ZOO[which], 0.05, 5), (4, 3, 6))
    cut = Cut(axis, at)
    n = cut.dimension
    low = placed.center[n] - placed.item.extents[n] / 2
    high = low + placed.item.extents[n]
    left = section(placed, cut)
    assert is_beyond(placed, cut) == (low >= round(at / FINE) * FINE)
    assert (left is None) == (high <= round(at / FINE) * FINE or is_beyond(placed, cut))
    if left is not None and len(left.rest.faces):
        assert left.rest.bounds[1][n] + placed.center[n] <= at + FINE


@pytest.fixture
def number_of_bodies(monkeypatch: pytest.MonkeyPatch) -> Callable[[], int]:
    """Count the bodies of the world of the only scene that is opened."""
    worlds = Watched(monkeypatch, "packit_sim.render.scene", "open_world")
    added = Watched(monkeypatch, SoftwareWorld, "add_body")
    removed = Watched(monkeypatch, SoftwareWorld, "remove")

    def count() -> int:
        (world,) = worlds.returned
        if isinstance(world, SoftwareWorld):
            return len(added.calls) - len(removed.calls)
        assert isinstance(world, bullet.EglWorld)
        return int(pybullet.getNumBodies(physicsClientId=world.number))

    return count


def test_a_cut_shows_the_section_and_takes_away_what_is_beyond(
    renderer: str, number_of_bodies: Callable[[], int]
) -> None:
    look = Look(FRONT, box="edges")
    with Scene(three_cubes()) as scene:
        whole = scene.snapshot(SIDE, SIDE, look)
        opened = scene.snapshot(SIDE, SIDE, dataclasses.replace(look, cut=Cut("y", 0.15)))
        again = scene.snapshot(SIDE, SIDE, look)
        bodies = number_of_bodies()
    assert set(np.unique(opened.segmentation)) == {-1, 0, 2}
    assert opened.depth[opened.segmentation == 0].min() == pytest.approx(
        whole.depth[whole.segmentation == 0].min() + 0.15, abs=0.012
    )
    assert np.array_equal(whole.image, again.image)
    assert bodies == 3 + 2


@pytest.mark.parametrize("renderer", OFTEN_OPENED, indirect=True)
def test_a_world_is_replaced_before_it_has_too_many_sections(
    renderer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("packit_sim.render.scene.MAX_SECTIONS", 6000)
    worlds = Watched(monkeypatch, "packit_sim.render.scene", "open_world")
    stagers = Watched(monkeypatch, "packit_sim.render.scene", "BodyStager")
    box = Box()
    box.place(Item(BALL, 0.1), (5, 5, 0))
    with Scene(box) as scene:
        for at in (0.3, 0.31, 0.32, 0.33, 0.34):
            shot = scene.snapshot(SIDE, SIDE, Look(FRONT, cut=Cut("y", at)))
            assert set(np.unique(shot.segmentation)) == {-1, 0}
            assert stagers.returned[-1].triangles < 12000
    assert len(worlds.calls) > 1


def test_panes_of_glass_are_before_and_behind_and_change_no_measure() -> None:
    with Scene(three_cubes()) as scene:
        solid = scene.snapshot(SIDE, SIDE)
        ghost = scene.snapshot(SIDE, SIDE, Look(box="ghost"))
    items = ghost.segmentation >= 0
    assert np.array_equal(np.isfinite(ghost.depth), items)
    assert np.array_equal(np.unique(ghost.segmentation), [-1, 0, 1, 2])
    assert np.array_equal(ghost.projection, solid.projection)
    tinted = ghost.image[SIDE // 2, SIDE // 2].astype(int)
    assert 5 < np.abs(tinted - BACKGROUND).max() < 90 or items[SIDE // 2, SIDE // 2]
    assert (ghost.image[0, 0] == BACKGROUND).all()
    common = items & (solid.segmentation == ghost.segmentation)
    change = np.abs(ghost.image[common].astype(int) - solid.image[common])
    assert 0 < np.median(change.max(axis=1)) < 60


def test_what_stands_before_the_glass_is_not_behind_it() -> None:
    items = [cube_of(30)]
    standing = Layout.standing(items)
    near = dataclasses.replace(
        standing.poses[0], translation=CENTRE + 1.2 * np.array((0.47, 0.88, 0.0))
    )
    layout = Layout((near,), standing.points)
    shots = []
    with Scene(BoxState((100, 100, 100), layout.posed(items))) as scene:
        shots += [scene.snapshot(SIDE, SIDE, Look(box=b), layout) for b in ("ghost", "edges")]
    item = (shots[0].segmentation == 0) & (shots[1].segmentation == 0)
    assert item.sum() > 100
    assert (shots[0].image[item] == shots[1].image[item]).mean() > 0.95


@pytest.mark.parametrize("background", [(0, 0, 0), (255, 255, 255), (30, 60, 120)])
def test_the_background_and_edges_that_can_be_seen_on_it(background) -> None:
    with Scene(Box()) as scene:
        shot = scene.snapshot(SIDE, SIDE, Look(background=background))
    assert (shot.image[0] == background).all()
    drawn = shot.image[np.isfinite(shot.depth)].astype(int)
    assert np.abs(drawn - background).max(axis=1).max() > 90


def test_colours_are_the_look_s_and_go_back(renderer: str) -> None:
    blue_to_yellow = ByNumber("score", {0: 0.0, 2: 1.0})
    with Scene(three_cubes()) as scene:
        before = scene.snapshot(SIDE, SIDE)
        colored = scene.snapshot(SIDE, SIDE, Look(coloring=blue_to_yellow))
        after = scene.snapshot(SIDE, SIDE)
    assert np.array_equal(before.segmentation, colored.segmentation)
    assert np.array_equal(before.image, after.image)
    assert before.legend is None and colored.legend is not None
    colors = [np.median(colored.image[colored.segmentation == n], axis=0) for n in range(3)]
    assert colors[0][2] > colors[0][0] and colors[2][0] > colors[2][2] + 50
    assert np.ptp(colors[1]) < 12


def test_a_new_item_with_an_old_body_s_number_is_in_its_own_place(renderer: str) -> None:
    """PyBullet gives a removed body's number to the next."""
    box = three_cubes()
    with Scene(box) as scene:
        scene.snapshot(SIDE, SIDE, Look(explode=1.0, coloring=by_order))
        box.undo()
        box.place(Item(BALL, 0.05), (0, 16, 0))
        scene.update(box)
        ours = scene.snapshot(SIDE, SIDE)
    with Scene(box) as fresh:
        theirs = fresh.snapshot(SIDE, SIDE)
    assert np.array_equal(ours.segmentation, theirs.segmentation)
    assert (ours.image != theirs.image).any(axis=2).mean() < 1e-3


def test_a_layout_puts_items_anywhere_or_nowhere() -> None:
    items = [cube_of(20), Item(BALL, 0.02), Item(RING, 0.05)]
    layout = Layout.standing(items, np.ones(3))
    with Scene(BoxState((100, 100, 100), layout.posed(items))) as scene:
        whole = scene.snapshot(2 * SIDE, SIDE, Look(), layout)
        hidden = dataclasses.replace(layout, poses=(layout.poses[0], None, layout.poses[2]))
        less = scene.snapshot(2 * SIDE, SIDE, Look(), hidden)
    assert set(np.unique(whole.segmentation)) == {-1, 0, 1, 2}
    assert set(np.unique(less.segmentation)) == {-1, 0, 2}
    middles = [np.argwhere(whole.segmentation == n).mean(axis=0) for n in range(3)]
    at = seen(whole.projection, np.array([pose.translation for pose in layout.poses]))
    assert np.allclose(np.array(middles)[:, ::-1], at, atol=3)


def test_arrays_are_written_whole_or_not_at_all(tmp_path: Path) -> None:
    with Scene(three_cubes()) as scene:
        shot = scene.snapshot(40, 30)
    shot.save_arrays(tmp_path / "view.npz")
    with np.load(tmp_path / "view.npz") as arrays:
        for name in ("image", "depth", "segmentation", "projection"):
            assert np.array_equal(arrays[name], getattr(shot, name))
    with pytest.raises(RenderError, match="can't be written to"):
        shot.save_arrays(tmp_path / "nowhere" / "view.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["view.npz"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Look(box="glass"), "box 'glass' is not known: choose from edges, ghost, none"),
        (lambda: Look(explode=-0.1), r"explode -0.1 is not possible"),
        (lambda: Look(explode=float("nan")), "explode nan is not possible"),
        (lambda: Look(background=(0, 0, 256)), r"background \(0, 0, 256\)"),
        (lambda: Cut("w", 0.5), "axis 'w' of a cut is not known: choose from x, y, z"),
        (lambda: Cut("x", 0.0), "a cut at 0.0 is not possible"),
    ],
)
def test_impossible_looks(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_looks_are_values() -> None:
    look = Look(FRONT, cut=Cut("z", 0.4), coloring=ByShare(0.5))
    assert pickle.loads(pickle.dumps(look)) == look and hash(look) == hash(
        Look(*vars(look).values())
    )


def test_an_environment_renders_its_look() -> None:
    settings = {"observation": "none", "render_mode": "rgb_array"}
    look = Look(background=(10, 20, 30), box="ghost")
    with gymnasium.make("PackIt-v0", look=look, **settings) as env:
        env.reset(seed=0)
        first = env.render()
        assert (first[0, 0] == (10, 20, 30)).all() and first.shape == (512, 512, 3)


MESALESS = {"__EGL_VENDOR_LIBRARY_DIRS": "/nowhere", "LIBGL_DRIVERS_PATH": "/nowhere"}
HERE = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(Path(__file__).parents[1])}


@pytest.mark.slow
@pytest.mark.parametrize(
    "missing",
    [
        pytest.param({}, id="no display", marks=pytest.mark.slow),
        pytest.param(MESALESS, id="no Mesa"),
    ],
)
def test_without_a_display_and_without_mesa(missing: dict[str, str], tmp_path: Path) -> None:
    code = (
        "from packit_sim.box import Box; from packit_sim.scene import Scene\n"
        "with Scene(Box()) as scene: print(scene.snapshot(32, 32).renderer)"
    )
    home = {"HOME": str(tmp_path)}
    ran = subprocess.run(
        [sys.executable, "-c", code],
        env=HERE | home | missing,
        capture_output=True,
        text=True,
        timeout=120,
    )
    expected = "software" if missing or bullet.egl_problem() is not None else "egl"
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, f"{expected}\n", "")


def test_what_a_picture_is_of_does_not_grow_with_pictures(
    number_of_bodies: Callable[[], int],
) -> None:
    looks = [Look(), Look(cut=Cut("y", 0.2)), Look(cut=Cut("x", 0.2)), Look(box="ghost")]
    with Scene(three_cubes()) as scene:
        counts = []
        for look in looks * 2:
            scene.snapshot(24, 24, look)
            counts.append(number_of_bodies())
    assert counts[:4] == counts[4:] and max(counts) <= 5 + 2 * 3
    assert CELL == 4 * FINE
