"""The measure of first answers sees what a command shows, and does not hide failures."""

import json
import sys

import pytest

from benchmarks import first_answers, packing_parts
from benchmarks.common import RESULTS, table_in_page

SHOWS_AFTER_A_SECOND = """
import signal, time
time.sleep(1)
try:
    print("packing 3 of 8 parts, density 0.123", flush=True)
    signal.pause()
except KeyboardInterrupt:
    time.sleep(1)
"""


def test_the_first_packing_ends_the_command() -> None:
    run = first_answers.measure([sys.executable, "-c", SHOWS_AFTER_A_SECOND])
    assert run["parts"] == 3 and run["shown"] >= 1
    assert round(run["ended"] - run["shown"], 2) >= 1  # both times are rounded to hundredths
    assert run["memory"] > 5


def test_a_command_without_a_packing_is_an_error() -> None:
    with pytest.raises(RuntimeError, match="no part fits"):
        first_answers.measure([sys.executable, "-c", "print('no part fits')"])


def test_the_page_has_the_results() -> None:
    runs = json.loads((RESULTS / first_answers.FILE).read_text())["runs"]
    assert table_in_page(packing_parts.PAGE, first_answers.BLOCK) == first_answers.table(runs)
