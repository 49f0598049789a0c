"""Films: how items enter, continuity of motion, and the contents of files."""

from __future__ import annotations

import dataclasses
import subprocess
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image
from trimesh import creation

from packit_sim.box import Box
from packit_sim.core.errors import RenderError
from packit_sim.core.extras import MissingPackageError
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.render import films, video
from packit_sim.render.films import Pace, packing, shot, sides, turning
from packit_sim.render.image_files import RGBImage
from packit_sim.render.layouts import Layout
from packit_sim.render.looks import Cut, Look
from tests.zoo import BALL, RING, cube_of

pytestmark = pytest.mark.usefixtures("software")

PACE = Pace(fps=10, flight=2.0, gap=1.0, rest=0.5)


def packed() -> Box:
    box = Box()
    for item, location in (
        (cube_of(40), (0, 0, 0)),
        (Item(BALL, 0.1), (10, 12, 0)),
        (Item(RING, 0.1, 4), (0, 10, 12)),
    ):
        box.place(item, location)
    return box


def cuboid(x: int, y: int, z: int) -> Item:
    """Of so many cells."""
    shape = Shape.from_mesh(creation.box((x, y, z)), f"{x}x{y}x{z}")
    return Item(shape, (np.linalg.norm((x, y, z)) / 100) ** 3)


def test_items_come_from_where_they_can() -> None:
    box = Box()
    lid = cuboid(100, 100, 8)
    box.place(lid, (0, 0, 20))  # from above
    box.place(cuboid(96, 8, 60), (0, 20, 0))  # the lid is above: from the front
    box.place(cuboid(8, 60, 60), (22, 0, 0))  # a wall in front, the lid above: from the right
    box.place(cuboid(40, 40, 40), (0, 4, 0))  # a third wall at the right: from the left
    box.place(cuboid(8, 60, 60), (10, 0, 0))  # to the right and the left of it are others
    assert sides(box) == [(2, 1), (1, 1), (0, 1), (0, -1), (1, -1)]
    assert sides(Box()) == []


def test_every_item_goes_from_its_stand_to_its_place() -> None:
    box = packed()
    frames = list(packing(box, pace=PACE))
    assert len(frames) == round(PACE.seconds(3) * PACE.fps) + 1 == 51
    layouts = [layout for _, layout in frames]
    outside = Layout.standing([placed.item for placed in box.placed], np.ones(3))
    inside = Layout.packed(box.placed, np.ones(3))
    for layout, poses in ((layouts[0], outside.poses), (layouts[-1], inside.poses)):
        for pose, wanted in zip(layout.poses, poses, strict=True):
            assert np.array_equal(pose.translation, wanted.translation) and pose.wxyz == wanted.wxyz
    for n in range(3):
        centers = np.array([layout.poses[n].translation for layout in layouts])
        moving = np.flatnonzero((np.diff(centers, axis=0) != 0).any(axis=1))
        start = (PACE.rest + n * PACE.gap) * PACE.fps
        assert start - 1 <= moving[0] <= start + 1
        assert start + PACE.flight * PACE.fps - 2 <= moving[-1] <= start + PACE.flight * PACE.fps
        assert moving[-1] - moving[0] == len(moving) - 1


def test_nothing_jumps_and_it_starts_and_ends_gently() -> None:
    layouts = [layout for _, layout in packing(packed(), pace=Pace(50, 2.0, 1.0, 0.5))]
    for n in range(3):
        centers = np.array([layout.poses[n].translation for layout in layouts])
        steps = np.linalg.norm(np.diff(centers, axis=0), axis=1)
        assert steps.max() < 2.5 * steps.sum() / 100
        assert np.abs(np.diff(steps)).max() < steps.max() / 8
        turns = np.array([layout.poses[n].wxyz for layout in layouts])
        angles = 1 - np.abs((turns[1:] * turns[:-1]).sum(axis=1))
        assert angles.max() < 0.01


def test_an_item_comes_from_outside_and_is_turned_before_it_is_in() -> None:
    box = packed()
    layouts = [layout for _, layout in packing(box, pace=Pace(50, 2.0, 1.0, 0.5))]
    for n, (placed, (axis, side)) in enumerate(zip(box.placed, sides(box), strict=True)):
        final = np.array(layouts[-1].poses[n].wxyz)
        for layout in layouts:
            pose = layout.poses[n]
            if ((pose.translation > 0) & (pose.translation < 1)).all():
                assert abs(abs(np.array(pose.wxyz) @ final) - 1) < 1e-6
                others = [a for a in range(3) if a != axis]
                assert np.allclose(pose.translation[others], placed.center[others], atol=1e-6)
                assert side * (pose.translation[axis] - placed.center[axis]) > -1e-9


def test_every_frame_has_the_same_view_and_all_stays_in_it() -> None:
    frames = list(packing(packed(), pace=PACE))
    assert len({id(layout.points) for _, layout in frames}) == 1
    for picture in shot(packed(), frames[::10], 64, 36):
        assert picture.shape == (36, 64, 3)
        assert not (picture[-1] != picture[-1, 0]).any()


@pytest.mark.parametrize("look", [Look(cut=Cut("x", 0.5)), Look(explode=0.1)])
def test_a_box_that_is_cut_or_apart_is_not_packed(look: Look) -> None:
    with pytest.raises(ValueError, match="film a turn"):
        packing(packed(), look, PACE)


@pytest.mark.parametrize("look", [Look(cut=Cut("z", 0.1)), Look(explode=0.5)])
def test_a_turn_is_of_a_box_that_is_cut_or_apart(look: Look) -> None:
    box = packed()
    other, usual = (
        np.array(list(shot(box, turning(box, 3, way), 48, 48)), dtype=int) for way in (look, Look())
    )
    changed = (np.abs(other - usual).max(axis=3) > 20).mean(axis=(1, 2))
    assert changed.max() > 0.03


def test_an_empty_box_is_filmed_too() -> None:
    assert len(list(packing(Box(), pace=PACE))) == 11
    assert sum(1 for _ in shot(Box(), turning(Box(), 3), 32, 32)) == 3


def test_a_turn_ends_where_it_began_and_the_box_keeps_its_size() -> None:
    box = packed()
    frames = list(turning(box, 8, Look(explode=0.5)))
    azimuths = [look.camera.azimuth for look, _ in frames]
    assert np.allclose(np.diff([*azimuths, azimuths[0] + 360]), 45)
    points = frames[0][1].points
    eyes = np.array([look.camera.eye(points, 1.0) for look, _ in frames])
    assert np.ptp(np.linalg.norm(eyes[:, :2] - 0.5, axis=1)) < 1e-2 and np.ptp(eyes[:, 2]) < 1e-2


@pytest.mark.parametrize("items", [0, 1, 30])
def test_a_film_lasts_as_long_as_it_is_to(items: int) -> None:
    assert Pace.lasting(7.0, items, 20).seconds(items) == pytest.approx(7.0)


@pytest.mark.parametrize("name", ["fps", "flight", "gap", "rest"])
def test_impossible_paces(name: str) -> None:
    for value in (0, -1, float("nan"), 1e400):
        with pytest.raises(ValueError, match=f"{name} .*not possible"):
            dataclasses.replace(Pace(), **{name: value})


def stripes(count: int, width: int = 64, height: int = 48) -> Iterator[RGBImage]:
    """A red bar that goes from left to right over grey."""
    for n in range(count):
        picture = np.full((height, width, 3), 200, dtype=np.uint8)
        picture[:, 4 * n : 4 * n + 8] = (220, 30, 40)
        yield picture


def decoded(path: Path) -> tuple[str, np.ndarray]:
    """Ffmpeg's description of a film, and its frames."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path)]
    ran = subprocess.run(
        [*command, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"], capture_output=True
    )
    return ran.stderr.decode(), np.frombuffer(ran.stdout, dtype=np.uint8).reshape(-1, 48, 64, 3)


def test_mp4_holds_the_frames_at_a_constant_rate(tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    assert video.write(path, stripes(12), 20) == 12
    description, frames = decoded(path)
    assert "20 fps" in description and "64x48" in description and "h264" in description
    assert len(frames) == 12
    for frame, wanted in zip(frames, stripes(12), strict=True):
        assert np.abs(frame.astype(int) - wanted).mean() < 12
        assert np.abs(frame[:, :, 1].mean(axis=0) - wanted[:, :, 1].mean(axis=0)).max() < 60
    assert path.read_bytes().find(b"moov") < path.read_bytes().find(b"mdat")  # plays as it loads


def test_gif_has_the_frames_in_one_palette(tmp_path: Path) -> None:
    path = tmp_path / "film.gif"
    assert video.write(path, stripes(12), 20) == 12
    with Image.open(path) as film:
        assert (film.n_frames, film.size, film.info["loop"]) == (12, (64, 48), 0)
        for n, wanted in enumerate(stripes(12)):
            film.seek(n)
            assert film.info["duration"] == 50
            assert np.abs(np.asarray(film.convert("RGB")).astype(int) - wanted).max() <= 4
    assert path.stat().st_size < 4000  # only what changes is in a frame


@pytest.mark.parametrize("suffix", video.SUFFIXES)
def test_a_film_that_breaks_off_leaves_nothing(suffix: str, tmp_path: Path) -> None:
    def broken() -> Iterator[RGBImage]:
        yield from stripes(5)
        raise KeyboardInterrupt

    path = tmp_path / f"film{suffix}"
    path.write_bytes(b"as it was")
    with pytest.raises(KeyboardInterrupt):
        video.write(path, broken(), 10)
    assert path.read_bytes() == b"as it was" and list(tmp_path.iterdir()) == [path]
    with pytest.raises(RenderError, match="without pictures"):
        video.write(path, iter(()), 10)
    with pytest.raises(RenderError, match="can't be written to"):
        video.write(tmp_path / "nowhere" / path.name, stripes(2), 10)
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_no_film(tmp_path: Path) -> None:
    with pytest.raises(RenderError, match=r"film\.avi is no film: .*\.mp4 or \.gif"):
        video.require("film.avi")
    with pytest.raises(RenderError, match="63 x 48 pixels is not possible as MP4"):
        video.write(tmp_path / "a.mp4", stripes(2, 63), 10)
    assert video.write(tmp_path / "A.GIF", stripes(2, 63), 10) == 2


def test_without_ffmpeg_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingPackageError, match=r"packit-sim\[view\].*\.gif"):
        video.require("film.mp4")
    video.require("film.gif")


def test_the_film_s_items_are_seen_on_their_way() -> None:
    box = packed()
    frames = list(packing(box, pace=PACE))
    pictures = [next(shot(box, [frames[n]], 96, 54)) for n in (0, 15, 50)]
    changed = [np.abs(a.astype(int) - b).max(axis=2) > 20 for a, b in pairwise(pictures)]
    assert all(0.01 < part.mean() < 0.6 for part in changed)
    assert Look() == films.DEFAULT_LOOK
