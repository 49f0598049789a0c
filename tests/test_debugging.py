"""Wrong updates of state are found by the code itself, where a test run switches that on."""

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from packit_agents.placements.free_space import FreeSpace
from packit_sim.box import Box
from packit_sim.core import debugging
from packit_sim.engine import nofit, occupancy
from packit_sim.engine.occupancy import Occupancy
from packit_sim.engine.screening_kernels import FREE
from packit_sim.game.datasets.packs import LibraryRef, Pack, Task
from packit_sim.game.episodes.episode import Episode
from packit_sim.geometry.shapes import Item
from packit_sim.placement import PlacedItem
from tests.zoo import BALL, RING, cube_of

fill, unfill, append = occupancy.fill, occupancy.unfill, occupancy.append


def without_the_last_brick(box: Any, pages: int, item: Any, start: int) -> Any:
    bricks, outer, inner, first, fine = item
    few = bricks[:-1], outer[:-1], inner[:-1], first[:-1], fine[: first[-2]]
    return fill(box, pages, few, start)


def with_another_fine_cell(box: Any, pages: int, item: Any, start: int) -> Any:
    *rest, fine = item
    return fill(box, pages, (*rest, fine ^ np.uint64(1)), start)


def one_page_more(*arguments: Any) -> Any:
    pages, before, shared = fill(*arguments)
    return pages + 1, before, shared


def next_to_it(placed: Any, count: int, fixed: Any, location: Any) -> None:
    append(placed, count, fixed, (location[0] + 1, *location[1:]))


def not_at_all(*arguments: Any) -> None:
    pass


def without_the_shared_cells(
    box: Any, pages: int, bricks: Any, start: int, before: Any, shared: Any
) -> None:
    unfill(box, pages, bricks, start, before, shared[:0])


def use(box: Occupancy[PlacedItem]) -> None:
    """Add three items that share bricks, and remove the last two."""
    for item in (Item(BALL, 0.0025), Item(RING, 0.004), cube_of(5.3)):
        box.add(PlacedItem(item, (1, 1, 1)))
    box.truncate(1)


@pytest.mark.parametrize(
    ("kernel", "wrong"),
    [
        ("fill", without_the_last_brick),
        ("fill", with_another_fine_cell),
        ("fill", one_page_more),
        ("append", next_to_it),
        ("append", not_at_all),
        ("unfill", not_at_all),
        ("unfill", without_the_shared_cells),
    ],
)
def test_a_wrong_update_of_occupied_cells_is_found(
    kernel: str, wrong: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    use(Occupancy((24, 24, 24)))
    monkeypatch.setattr(occupancy, kernel, wrong)
    with debugging.checking(False):
        use(Occupancy((24, 24, 24)))
    with debugging.checking(), pytest.raises(AssertionError):
        use(Occupancy((24, 24, 24)))


def test_an_item_that_the_box_does_not_list_is_found() -> None:
    box = Box((40, 40, 40))
    with debugging.checking():
        box.place(cube_of(8), (0, 0, 0))
        box.arrays[0][0, -1] = 1
        with pytest.raises(AssertionError, match="union"):
            box.place(cube_of(8), (4, 4, 4))


def test_a_wrong_table_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    box = Box((40, 40, 40))
    box.place(Item(BALL, 0.2**3), (2, 2, 2))
    tables = [nofit.NoFit(*sorted((box.placed[0].item, cube_of(8)), key=lambda item: item.key))]
    monkeypatch.setattr(nofit, "no_fit_tables", lambda placed, item: tables)
    with debugging.checking():
        box.feasible(cube_of(8))
        tables[0].states[:] = FREE
        with pytest.raises(AssertionError):
            box.feasible(cube_of(8))


def test_an_episode_whose_box_was_changed_is_found() -> None:
    task = Task((cube_of(8), cube_of(12)), Pack(LibraryRef("zoo", "1", ""), (40,) * 3, (), 0.0), ())

    def place_twice(episode: Episode) -> None:
        put = episode.box.put
        episode.box.put = lambda item, at: put(item, at) + 0 * put(item, (5, 5, 5))  # type: ignore

    for change in (
        place_twice,
        lambda episode: episode.outside.__setitem__(1, False),
        lambda episode: setattr(episode, "total", 0.5),
    ):
        episode = Episode(task)
        episode.step(0)
        episode.step(0)
        change(episode)
        with debugging.checking(), pytest.raises(AssertionError):
            episode.step(0)


@pytest.mark.slow
def test_free_space_that_lacks_a_location_is_found() -> None:
    box = Box((40, 40, 40))
    space = FreeSpace.empty([cube_of(8)], box.cells)
    with debugging.checking():
        space.rows(0, box)
        space.remove(0, 0, (3, 3, 3))
        with pytest.raises(AssertionError, match="the meshes exclude it"):
            space.rows(0, box)


@pytest.mark.parametrize(("value", "on"), [("1", True), ("0", False), (None, False)])
def test_the_variable_decides_in_a_new_process(
    value: str | None, on: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if value is None:
        monkeypatch.delenv(debugging.CHECK_VARIABLE, raising=False)
    else:
        monkeypatch.setenv(debugging.CHECK_VARIABLE, value)
    code = "from packit_sim.core import debugging; print(debugging.is_checking())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(on)
