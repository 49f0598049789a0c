"""The benchmark of packing parts packs what it says."""

import json

import numpy as np
import pytest

from benchmarks.common import RESULTS, table_in_page
from benchmarks.packing_parts import BLOCK, FILE, PAGE, SIZES, VOLUME, parts_of, selection, table
from packit_sim import ShapeLibrary
from packit_sim.geometry.lattice import CELL


def test_a_selection_has_the_volume_and_all_items_fit() -> None:
    library = ShapeLibrary.open("everyday")
    task, again = (selection(library, 3) for _ in range(2))
    space = np.prod(np.array(SIZES[3]) * CELL)
    assert task.cells == SIZES[3] and task.items == again.items
    assert 20 <= len(task.items) <= 60
    assert task.volume / space == pytest.approx(VOLUME, rel=0.1)


def test_parts_are_the_items_in_millimetres() -> None:
    task = selection(ShapeLibrary.open("everyday"), 7, SIZES[0], count=8, volume=0.25)
    parts = parts_of(task)
    assert len({part.name for part in parts}) == len(parts) == 8
    volume = sum(item.volume for item in task.items)
    assert volume == pytest.approx(0.25, rel=1e-9)
    for part, item in zip(parts, task.items, strict=True):
        assert part.mesh.extents == pytest.approx(300 * item.turned(0).extents)


def test_the_page_has_the_results() -> None:
    runs = json.loads((RESULTS / FILE).read_text())["runs"]
    assert table_in_page(PAGE, BLOCK) == table(runs)
