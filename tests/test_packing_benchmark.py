"""The benchmark of packing parts packs what it says."""

import numpy as np
import pytest

from benchmarks.packing_parts import SIZES, VOLUME, selection
from packit_sim import ShapeLibrary
from packit_sim.geometry.lattice import CELL


def test_a_selection_has_the_volume_and_all_items_fit() -> None:
    library = ShapeLibrary.open("everyday")
    task, again = (selection(library, 3) for _ in range(2))
    space = np.prod(np.array(SIZES[3]) * CELL)
    assert task.cells == SIZES[3] and task.items == again.items
    assert 20 <= len(task.items) <= 60
    assert task.volume / space == pytest.approx(VOLUME, rel=0.1)
