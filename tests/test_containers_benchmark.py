"""The benchmark of containers: all have the same volume, and its table is on the page."""

import json

import pytest

from benchmarks import containers, packing_parts
from benchmarks.common import RESULTS, table_in_page
from packit_sim import BoxType


def test_the_containers_have_the_same_volume() -> None:
    for each in containers.containers().values():
        volume = each.container.volume if isinstance(each, BoxType) else each.volume
        assert volume == pytest.approx(packing_parts.UNIT_MM**3)


def test_the_page_has_the_results() -> None:
    results = json.loads((RESULTS / containers.FILE).read_text())["results"]
    page = table_in_page(packing_parts.PAGE, containers.BLOCK)
    assert page == containers.table(results)
    assert all(each["problems"] == 0 for each in results)
