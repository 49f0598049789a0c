"""The PyBullet world: pictures by both renderers, clean-up, and an independent contact test."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pybullet
import pytest
import trimesh
from PIL import Image

from packit_sim.box import Box
from packit_sim.core.errors import RenderError
from packit_sim.geometry.bullet_meshes import convex_pieces
from packit_sim.geometry.lattice import CONTACT_TOLERANCE, Triple
from packit_sim.geometry.motions import IDENTITY, Motion
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.placement import BoxState, PosedItem
from packit_sim.render import bullet, renderers, software
from packit_sim.render.cameras import Camera
from packit_sim.render.looks import Look
from packit_sim.scene import Scene
from tests.examples import OFTEN_OPENED
from tests.watched import Watched
from tests.zoo import BALL, BOWL, CUBE, RING, ZOO, cube_of, fill, random_item

pytestmark = pytest.mark.usefixtures("software")


@pytest.fixture
def broken_probe(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """EGL that does not start: the probe ends with status 1."""
    monkeypatch.setattr(bullet, "EGL_PROBE", "raise SystemExit(1)")
    bullet.egl_problem.cache_clear()
    yield monkeypatch
    bullet.egl_problem.cache_clear()


def three_items() -> Box:
    """Three items that can all be seen."""
    box = Box()
    box.place(cube_of(30), (0, 0, 0))
    box.place(Item(BALL, 0.1), (10, 12, 0))
    box.place(Item(RING, 0.1, 4), (0, 10, 12))
    return box


def depth(one: Item, other: Item, offset: tuple[float, float, float]) -> float:
    """How deep two items interpenetrate with one's centre at an offset from the other's."""
    middle = np.full(3, 0.5)
    poses = (
        Motion.turn(item.rotation, center)
        for item, center in ((one, middle), (other, middle + offset))
    )
    pair = tuple(map(PosedItem.at, (one, other), poses))
    with Scene(BoxState((100, 100, 100), pair)) as scene:
        return scene.penetrations()[0, 1]


def test_an_open_box_is_not_taken_for_a_closed_one() -> None:
    """What stands in it does not penetrate it, though its rim could be closed by one face."""
    open_box = trimesh.creation.box((1, 1, 1))
    open_box.update_faces(open_box.face_normals[:, 2] < 0.5)
    box = Box()
    box.place(Item(Shape.from_mesh(open_box, "open-box"), 1.0), (0, 0, 0))
    box.place(cube_of(12), (5, 5, 1))
    with Scene(box) as scene:
        assert scene.penetrations() == {(0, 1): 0.0}


def test_snapshot_shows_every_item(renderer: str) -> None:
    with Scene(three_items()) as scene:
        shot = scene.snapshot(200, 160)
    assert shot.renderer == renderer
    assert (shot.image.shape, shot.image.dtype) == ((160, 200, 3), np.uint8)
    assert (shot.depth.shape, shot.depth.dtype) == ((160, 200), np.float32)
    assert (shot.segmentation.shape, shot.segmentation.dtype) == ((160, 200), np.int32)
    assert set(np.unique(shot.segmentation)) == {-1, 0, 1, 2}
    assert shot.image.std() > 10
    assert np.isinf(shot.depth[0, 0])
    assert np.isfinite(shot.depth[shot.segmentation >= 0]).all()


def test_renderers_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    if bullet.egl_problem() is not None:
        pytest.skip("EGL does not start here")
    shots = []
    for name in ("egl", "software"):
        monkeypatch.setenv(renderers.RENDERER_VARIABLE, name)
        with Scene(three_items()) as scene:
            shots.append(scene.snapshot(200, 200))
    egl, software = shots
    same = egl.segmentation == software.segmentation
    assert same.mean() > 0.97
    shown = same & (egl.segmentation >= 0)
    assert np.median(np.abs(egl.depth[shown] - software.depth[shown])) < 0.01


@pytest.mark.parametrize("cells", [(100, 100, 100), (200, 40, 80), (40, 40, 300)])
@pytest.mark.parametrize("camera", [Camera(), Camera(200, -35, 70), Camera(0, 80, 10)])
def test_the_whole_box_is_in_the_picture(cells: Triple, camera: Camera) -> None:
    with Scene(Box(cells)) as scene:
        for width, height in ((160, 90), (90, 160)):
            shown = np.isfinite(scene.snapshot(width, height, Look(camera)).depth)
            assert shown.any()
            assert not (shown[[0, -1]].any() or shown[:, [0, -1]].any())


def test_depth_is_in_box_units() -> None:
    with Scene(three_items()) as scene:
        camera = Camera(0, 89.9)
        shot = scene.snapshot(101, 101, Look(camera))
        corners = np.indices((2, 2, 2)).reshape(3, 8).T
        height = camera.eye(corners, 1.0, np.full(3, 0.5))[2]
    assert shot.depth[shot.segmentation == 0].min() == pytest.approx(height - 0.3, abs=0.01)


def test_a_shape_keeps_its_colour(renderer: str) -> None:
    first, second = Box(), Box()
    first.place(cube_of(30), (0, 0, 0))
    second.place(Item(BALL, 0.1), (10, 10, 0))
    second.place(cube_of(30), (0, 0, 0))
    colors = []
    for box, index in ((first, 0), (second, 1)):
        with Scene(box) as scene:
            shot = scene.snapshot(200, 200)
        colors.append(np.median(shot.image[shot.segmentation == index], axis=0))
    assert np.abs(colors[0] - colors[1]).max() <= 12


def test_update_equals_a_fresh_scene(renderer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    box = three_items()
    worlds = Watched(monkeypatch, "packit_sim.render.scene", "open_world")
    with Scene(box) as scene:
        (world,) = worlds.returned
        added = Watched(monkeypatch, world, "add_body")
        removed = Watched(monkeypatch, world, "remove")
        box.undo()
        box.place(Item(BOWL, 0.1), (15, 0, 0))
        box.place(Item(RING, 0.05, 9), (0, 10, 15))
        scene.update(box)
        assert len(added.calls) == 2 and len(removed.calls) == 1
        ours = scene.snapshot(160, 160)
    with Scene(box) as fresh:
        theirs = fresh.snapshot(160, 160)
    assert np.array_equal(ours.segmentation, theirs.segmentation)
    assert np.array_equal(ours.image, theirs.image)
    assert set(np.unique(ours.segmentation)) == {-1, 0, 1, 2, 3}


def test_update_to_a_box_of_other_cells_and_after_many_shapes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    worlds = Watched(monkeypatch, "packit_sim.render.scene", "open_world")
    with Scene(three_items()) as scene:
        monkeypatch.setattr("packit_sim.render.scene.MAX_SHAPES", 2)
        box = Box((60, 80, 100))
        box.place(cube_of(20), (5, 5, 0))
        scene.update(box)
        assert len(worlds.calls) == 2
        assert set(np.unique(scene.snapshot(120, 120).segmentation)) == {-1, 0}


@pytest.mark.parametrize("renderer", OFTEN_OPENED, indirect=True)
def test_a_world_is_replaced_before_it_has_too_many_triangles(
    renderer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("packit_sim.render.scene.MAX_TRIANGLES", 6000)
    worlds = Watched(monkeypatch, "packit_sim.render.scene", "open_world")
    drawn_by = bullet.EglWorld if renderer == "egl" else software.SoftwareWorld
    added = Watched(monkeypatch, drawn_by, "add_visual")
    with Scene(Box()) as scene:
        for scale in (0.1, 0.11, 0.12, 0.13):
            box = Box()
            box.place(Item(BALL, scale), (5, 5, 0))
            scene.update(box)
            world = worlds.returned[-1]
            shapes = [
                mesh for drawn, mesh, *_ in added.calls if drawn is world and mesh is BALL.mesh
            ]
            assert len(shapes) <= 2 and world.triangles <= 6000
            assert set(np.unique(scene.snapshot(64, 64).segmentation)) == {-1, 0}
            if isinstance(world, bullet.EglWorld):
                assert len(list(world.folder.iterdir())) == len(shapes) + 2


def test_more_triangles_than_egl_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("packit_sim.render.bullet._EGL_TRIANGLES", 3000)
    box = Box()
    for n, scale in enumerate((0.01, 0.011, 0.012)):
        box.place(Item(BALL, scale), (8 * n, 8 * n, 0))
    with Scene(box) as scene:
        assert set(np.unique(scene.snapshot(64, 64).segmentation)) == {-1, 0, 1, 2}
    if bullet.egl_problem() is None:
        monkeypatch.setenv(renderers.RENDERER_VARIABLE, "egl")
        with pytest.raises(RenderError, match=r"more than the 3,000 triangles.*=software"):
            Scene(box)


def test_without_walls_the_items_fill_the_picture(renderer: str) -> None:
    box = three_items()
    with Scene(box) as scene:
        shot = scene.snapshot(160, 120, Look(box="none"))
        assert set(np.unique(shot.segmentation)) == {-1, 0, 1, 2}
        items = shot.segmentation >= 0
        assert np.array_equal(np.isfinite(shot.depth), items)
        assert not (items[[0, -1]].any() or items[:, [0, -1]].any())
        across, upward = (np.ptp(np.flatnonzero(items.any(axis=axis))) + 1 for axis in (0, 1))
        assert across > 0.9 * 160 or upward > 0.9 * 120
        box.undo()
        scene.update(box)
        assert set(np.unique(scene.snapshot(160, 120, Look(box="none")).segmentation)) == {-1, 0, 1}
        scene.update(Box())
        assert not np.isfinite(scene.snapshot(160, 120, Look(box="none")).depth).any()


def test_both_sides_of_a_surface_are_drawn(renderer: str) -> None:
    turned = Shape(BOWL.mesh.copy(), "turned inside out", "")
    turned.mesh.invert()
    shown = []
    for shape in (BOWL, turned):
        box = Box()
        box.place(Item(shape, 0.5), (0, 0, 0))
        with Scene(box) as scene:
            shown.append(scene.snapshot(120, 120, Look(Camera(elevation=60))).segmentation == 0)
    assert shown[0].sum() > 500
    assert (shown[0] != shown[1]).mean() < 0.01


def test_save_is_a_png_that_names_its_renderer(renderer: str, tmp_path: Path) -> None:
    with Scene(three_items()) as scene:
        shot = scene.snapshot(64, 48)
    path = tmp_path / "picture.png"
    shot.save(path)
    with Image.open(path) as image:
        assert image.format == "PNG"
        assert image.info["Renderer"] == renderer
        assert np.array_equal(np.asarray(image), shot.image)
    for nowhere in (tmp_path / "missing" / "a.png", tmp_path, path / "a.png"):
        with pytest.raises(RenderError, match="can't be written to"):
            shot.save(nowhere)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("side", [0, -1, 2049])
def test_impossible_pictures(side: int) -> None:
    with Scene(Box()) as scene, pytest.raises(ValueError, match=f"{side} is not possible"):
        scene.snapshot(side, 64)
    with pytest.raises(ValueError, match="fov 0"):
        Camera(fov=0)
    with pytest.raises(ValueError, match="elevation 90"):
        Camera(elevation=90)


@pytest.mark.parametrize("probe", ["raise SystemExit(1)", "import time; time.sleep(60)"])
def test_a_broken_egl_falls_back(broken_probe: pytest.MonkeyPatch, probe: str) -> None:
    broken_probe.setattr(bullet, "EGL_PROBE", probe)
    broken_probe.setattr(bullet, "PROBE_TIMEOUT", 0.5)
    broken_probe.setenv(renderers.RENDERER_VARIABLE, "auto")
    with Scene(three_items()) as scene:
        assert scene.renderer == "software"
        assert scene.snapshot(64, 64).renderer == "software"


def test_egl_on_demand_says_what_is_missing(broken_probe: pytest.MonkeyPatch) -> None:
    broken_probe.setenv(renderers.RENDERER_VARIABLE, "egl")
    with pytest.raises(RenderError, match=r"status 1.*libegl1 libgl1-mesa-dri"):
        Scene(Box())
    broken_probe.setenv(renderers.RENDERER_VARIABLE, "opengl")
    with pytest.raises(RenderError, match=r"'opengl'.*auto, egl or software"):
        Scene(Box())


@pytest.mark.slow
def test_only_one_scene_at_a_time_draws_with_egl(monkeypatch: pytest.MonkeyPatch) -> None:
    if bullet.egl_problem() is not None:
        pytest.skip("EGL does not start here")
    monkeypatch.setenv(renderers.RENDERER_VARIABLE, "auto")
    with Scene(three_items()) as first, Scene(three_items()) as second:
        assert (first.renderer, second.renderer) == ("egl", "software")
        second.snapshot(64, 64)
        assert set(np.unique(first.snapshot(64, 64).segmentation)) == {-1, 0, 1, 2}
        monkeypatch.setenv(renderers.RENDERER_VARIABLE, "egl")
        with pytest.raises(RenderError, match="another scene"):
            Scene(Box())
    with Scene(Box()) as third:
        assert third.renderer == "egl"


def test_close_ends_everything_and_twice_is_fine(monkeypatch: pytest.MonkeyPatch) -> None:
    worlds = Watched(monkeypatch, "packit_sim.render.scene", "ContactWorld")
    scene = Scene(three_items())
    scene.penetrations()
    folder, client = worlds.returned[0].folder, worlds.returned[0].number
    assert folder.exists() and pybullet.isConnected(client)
    scene.close()
    scene.close()
    assert not folder.exists() and not pybullet.isConnected(client)
    for use in (scene.snapshot, scene.penetrations, lambda: scene.update(Box())):
        with pytest.raises(RenderError, match="closed"):
            use()


def test_a_forgotten_scene_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    worlds = Watched(monkeypatch, "packit_sim.render.scene", "ContactWorld")
    scene = Scene(three_items())
    scene.penetrations()
    contacts = worlds.returned.pop()
    folder, client = contacts.folder, contacts.number
    del scene, contacts
    gc.collect()
    assert not folder.exists() and not pybullet.isConnected(client)


def test_another_thread_is_refused() -> None:
    errors: list[Exception] = []

    def use() -> None:
        for method in (scene.snapshot, scene.penetrations, scene.close):
            try:
                method()
            except RenderError as error:
                errors.append(error)

    with Scene(Box()) as scene:
        thread = threading.Thread(target=use)
        thread.start()
        thread.join()
    assert len(errors) == 3 and all("thread" in str(error) for error in errors)


def test_a_forked_child_is_refused() -> None:
    with Scene(three_items()) as scene:
        child = os.fork()
        if child == 0:
            try:
                scene.snapshot(16, 16)
            except RenderError as error:
                os._exit(7 if "forked" in str(error) else 1)
            os._exit(2)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
        scene.snapshot(16, 16)


NO_PYBULLET = """
import sys
sys.modules["pybullet"] = None
from packit_sim import Item, PackItError, Scene, ShapeLibrary, Box
box = Box()
item = Item(ShapeLibrary.open("everyday")["teapot"], 0.1)
box.place(item, box.blbf(item))
with Scene(box) as scene:
    shot = scene.snapshot(64, 64)
    print(shot.renderer, (shot.segmentation == 0).sum() > 20)
    try:
        scene.penetrations()
    except PackItError as error:
        print(error)
"""


@pytest.mark.slow
def test_without_pybullet_pictures_are_drawn_and_contacts_name_the_extra(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(renderers.RENDERER_VARIABLE, "auto")
    ran = subprocess.run([sys.executable, "-c", NO_PYBULLET], capture_output=True, text=True)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout.splitlines() == [
        "software True",
        "contacts of a scene need pybullet, which is not installed: "
        "pip install 'packit-sim[physics]'",
    ]


@pytest.mark.slow
def test_nothing_on_the_terminal(tmp_path: Path) -> None:
    code = (
        "from packit_sim.box import Box; from packit_sim.scene import Scene\n"
        "print('before'); scene = Scene(Box()); scene.snapshot(32, 32); scene.penetrations()\n"
        "scene.close(); Scene(Box()); kept = Scene(Box()); print('after')"
    )
    environment = os.environ | {renderers.RENDERER_VARIABLE: "auto"}
    ran = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60
    )
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "before\nafter\n", "")


@pytest.mark.slow
def test_thirty_scenes_leave_nothing_open(renderer: str) -> None:
    box = three_items()

    def open_and_close() -> None:
        with Scene(box) as scene:
            scene.snapshot(32, 32)

    open_and_close()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(30 if renderer == "software" else 5):
        open_and_close()
    assert len(os.listdir("/proc/self/fd")) <= before + 1
    assert not any(pybullet.isConnected(client) for client in range(64))


def l_prism() -> Shape:
    """A closed body that is not convex: two boxes' L."""
    corner, wide, high = (0, 0), 1.0, 0.4
    outline = np.array([corner, (wide, 0), (wide, high), (high, high), (high, wide), (0, wide)])
    bottom, top = np.c_[outline, np.zeros(6)], np.c_[outline, np.ones(6)]
    caps = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)])
    a, b = np.arange(6), (np.arange(6) + 1) % 6
    sides = np.r_[np.c_[a, b, b + 6], np.c_[a, b + 6, a + 6]]
    mesh = trimesh.Trimesh(np.r_[bottom, top], np.r_[caps[:, ::-1], caps + 6, sides])
    assert mesh.is_volume and not mesh.is_convex
    return Shape.from_mesh(mesh, "l-prism")


@pytest.mark.parametrize("shape", [CUBE, l_prism()], ids=lambda shape: shape.id)
@pytest.mark.parametrize("aside", [(0.0, 0.0), (0.05, 0.033)])
def test_overlap_face_to_face(shape: Shape, aside: tuple[float, float]) -> None:
    item = Item(shape, 0.05)
    width = float(item.extents[0])
    for overlap in (1e-4, 1e-3, 1e-2):
        found = depth(item, item, (width - overlap, *aside))
        assert overlap - 2e-4 * width <= found <= overlap * 1.001
    for gap in (0.0, 1e-6, 1e-4, 1e-2):
        assert depth(item, item, (width + gap, *aside)) <= CONTACT_TOLERANCE / 100


@pytest.mark.parametrize("rotation", [0, 5, 17])
@pytest.mark.parametrize("scale", [0.01, 0.125])
def test_turned_rings_on_top_of_each_other(rotation: int, scale: float) -> None:
    ring = Item(RING, scale, rotation)
    flat = int(ring.extents.argmin())
    for overlap in (-1e-4, 0.0, 1e-4, 1e-3):
        offset = np.zeros(3)
        offset[flat] = ring.extents[flat] - overlap
        x, y, z = offset.tolist()
        assert depth(ring, ring, (x, y, z)) == pytest.approx(max(overlap, 0.0), abs=2e-6, rel=0.05)


def test_a_ball_in_a_bowl() -> None:
    bowl = Item(BOWL, 0.125)
    radius = float(bowl.extents[0]) / 2
    ball = Item(BALL, (1.2 * radius) ** 3)
    rest = float(bowl.extents[2] / 2 - radius + ball.extents[2] / 2)
    assert depth(bowl, ball, (0.0, 0.0, rest + 2e-3)) <= CONTACT_TOLERANCE
    assert depth(bowl, ball, (0.0, 0.0, rest - 1e-2)) > 10 * CONTACT_TOLERANCE
    assert depth(ball, bowl, (0.0, 0.0, 1e-2 - rest)) > 10 * CONTACT_TOLERANCE


def test_accepted_items_do_not_interpenetrate() -> None:
    rng = np.random.default_rng(8)
    box = Box()
    fill(box, [random_item(ZOO, 0.35, rng) for _ in range(30)], rng)
    with Scene(box) as scene:
        found = scene.penetrations()
    assert len(box.placed) > 10 and len(found) > 10
    assert max(found.values()) <= CONTACT_TOLERANCE


@pytest.mark.slow
def test_egl_frees_its_memory() -> None:
    if bullet.egl_problem() is not None:
        pytest.skip("EGL does not start here")
    command = [sys.executable, "-c", GROWTH]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    assert abs(int(done.stdout.splitlines()[-1])) < 1e6  # it kept 13 MB of OBJ files


GROWTH = """
import ctypes, gc
import numpy as np, trimesh
from packit_sim.geometry.motions import IDENTITY
from packit_sim.render.bullet import EglWorld

class MemoryInUse(ctypes.Structure):
    names = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    _fields_ = [(name, ctypes.c_size_t) for name in names.split()]

mallinfo2 = ctypes.CDLL(None).mallinfo2
mallinfo2.restype = MemoryInUse
ball = trimesh.creation.icosphere(subdivisions=5)
used = []
for _ in range(5):
    world = EglWorld()
    for scale in (0.1, 0.2, 0.3, 0.4):
        world.add_body(world.add_visual(ball, scale, (1, 0, 0)), IDENTITY)
    world.close()
    gc.collect()
    used.append(mallinfo2().uordblks)
print(used[-1] - used[1])
"""


@pytest.mark.slow
def test_an_empty_mesh_is_drawn_as_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    if bullet.egl_problem() is not None:
        pytest.skip("EGL does not start here")
    monkeypatch.setenv(renderers.RENDERER_VARIABLE, "egl")
    worlds = Watched(monkeypatch, "packit_sim.render.scene", "open_world")
    with Scene(three_items()) as scene:
        before = scene.snapshot(64, 64).image
        (world,) = worlds.returned
        assert isinstance(world, bullet.EglWorld)
        empty = trimesh.Trimesh(np.zeros((0, 3)), np.zeros((0, 3), int), process=False)
        world.add_body(world.add_visual(empty, 1.0, (1, 0, 0)), IDENTITY)
        assert np.array_equal(scene.snapshot(64, 64).image, before)


def test_convex_pieces_leave_nothing_in_the_mesh() -> None:
    mesh = trimesh.util.concatenate([BOWL.mesh, BALL.mesh])
    mesh._cache.clear()
    assert len(convex_pieces(mesh)) > 1
    assert "face_adjacency" not in mesh._cache.cache
