"""The campaign that compares instruction counts as repetitions in files double."""

import math
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import pytest

from campaigns.common import read_results
from campaigns.fuzzing.readers import READERS
from campaigns.growth import __main__ as campaign
from campaigns.growth import screening
from campaigns.growth.counting import NO_VALGRIND, is_installed
from campaigns.growth.kinds import kinds
from campaigns.growth.repetition import LONGEST, repeated
from campaigns.growth.screening import SUSPICIOUS, exponent, screened


@pytest.mark.parametrize("name", ["off", "orders", "parts-xlsx", "glb", "dae"])
def test_each_repetition_makes_the_file_longer(name: str) -> None:
    found = kinds(READERS[name])
    assert len(found) > 40 and len({one.name for one in found}) == len(found)
    for one in found[:: len(found) // 40]:
        sizes = [len(one.write(n)) for n in (8, 16, 32)]
        assert sizes[0] <= sizes[1] <= sizes[2] and sizes[0] < sizes[2], one.name
    last = found[-1]
    assert LONGEST / 4 < len(last.write(last.most)) - len(last.write(0)) <= LONGEST


def test_repetitions_inside_an_archive_are_packed_again() -> None:
    one = next(each for each in kinds(READERS["parts-xlsx"]) if "element row" in each.name)
    with zipfile.ZipFile(BytesIO(one.write(50))) as archive:
        assert max(archive.read(name).count(b"<row") for name in archive.namelist()) > 50 or any(
            archive.read(name).count(b"<c ") > 50 for name in archive.namelist()
        )


class Counted:
    """Counts what a function of the length of a file says."""

    def __init__(self, work: Callable[[int], float | None]) -> None:
        self._work = work

    def count(self, read: Callable[[], int]) -> int | None:
        found = self._work(read())
        return None if found is None else int(found)


@pytest.mark.parametrize(
    ("work", "exponent"),
    [
        (lambda n: 5e9 + 1000 * n, 1.0),
        (lambda n: 5e9 + n * n, 2.0),
        (lambda n: 5e9 + n, 0.0),
        (lambda n: 5e9 + 1000 * min(n, 4000), 0.0),
        (lambda n: None if n > 10_000 else n, math.inf),
    ],
)
def test_the_exponent_is_that_of_what_a_doubling_adds(
    work: Callable[[int], float | None], exponent: float
) -> None:
    one = repeated("newline", b"", b"\n", b"")
    assert one.most == 8192
    doubled = repeated("newlines", b"", b"\n\n", b"")
    assert campaign.growth(Counted(work), len, doubled) == pytest.approx(exponent, abs=0.01)


def test_a_planted_pattern_is_suspicious_and_linear_work_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(screening, "ENOUGH_SECONDS", 0.05)
    monkeypatch.setattr(screening, "SECONDS", 1)
    monkeypatch.setattr(screening, "ROUNDS", 2)
    newlines = repeated("newline", b"", b"\n", b"end")
    pattern = re.compile(rb"^\s*x", re.MULTILINE)
    assert screened(pattern.search, newlines) > 1.5
    assert screened(lambda data: sum(data), newlines) <= SUSPICIOUS
    assert screened(lambda data: re.match(rb"(\n+)+x", data), newlines) > 1.5


def test_times_that_double_are_linear() -> None:
    linear = [0.005 + 0.001 * 2**n for n in range(9)]
    assert 0.9 < exponent(linear) < 1.2
    assert exponent([0.005 + 0.0001 * 4**n for n in range(6)]) > 1.5
    assert exponent([0.001, 0.01, 0.02, 0.04]) == pytest.approx(1, abs=0.1)
    assert exponent([0.005, 0.005, 0.006, 0.02, 0.08, 0.0001]) > 1.5  # the longest is refused
    assert exponent([0.005, 0.0055, 0.006, 0.0085]) == 0


def test_without_valgrind_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign, "is_installed", lambda: False)
    monkeypatch.setattr(sys, "argv", ["growth"])
    with pytest.raises(SystemExit, match=re.escape(NO_VALGRIND)):
        campaign.main()


@pytest.mark.slow
@pytest.mark.skipif(not is_installed(), reason="Valgrind is not installed")
def test_instructions_are_counted(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "campaigns.growth", "--reader", "orders"]
    subprocess.run([*command, "--out", tmp_path], check=True, timeout=3600)
    row = read_results("growth", tmp_path)["readers"]["orders"]
    assert row["kinds"] > 40 and set(row["counted"]) == set(row["suspects"])
    assert all(each <= 1.3 for each in row["counted"].values()) and 0 <= row["largest"] <= 1.2
