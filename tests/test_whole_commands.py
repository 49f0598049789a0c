"""The benchmark of whole commands: its table is on the page."""

import json

from benchmarks import packing_parts, whole_commands
from benchmarks.common import RESULTS, table_in_page


def test_the_page_has_the_results() -> None:
    runs = json.loads((RESULTS / whole_commands.FILE).read_text())["runs"]
    page = table_in_page(packing_parts.PAGE, whole_commands.BLOCK)
    assert page == whole_commands.table(runs)
