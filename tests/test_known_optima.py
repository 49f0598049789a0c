"""Parts with a known optimum: the cases hold, and the page has their results."""

import json

import pytest

from benchmarks import known_optima
from benchmarks.common import RESULTS, table_in_page


@pytest.mark.parametrize("name", known_optima.CASES)
def test_the_parts_fill_no_more_than_the_box(name: str) -> None:
    case = known_optima.CASES[name]()
    volume = sum(part.count * part.mesh.volume for part in case.parts)
    x, y, z = case.box
    assert volume <= x * y * (case.optimum if case.objective == "height" else z)


@pytest.mark.slow
def test_the_pieces_of_a_cube_are_packed() -> None:
    found = known_optima.measure(known_optima.cut_cube(), 20.0, 0, 1)
    assert found["reached"] and found["value"] == 8 and found["problems"] == 0


def test_the_page_has_the_results() -> None:
    runs = json.loads((RESULTS / known_optima.FILE).read_text())["runs"]
    assert table_in_page(known_optima.PAGE) == known_optima.table(runs)
