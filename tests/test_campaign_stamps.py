"""Results of campaigns say of which sources they are, and are not older than the release."""

import pytest

from benchmarks.common import table_in_page
from campaigns import night
from campaigns.common import PAGES, RESULTS
from packit_sim.core.version import __version__

STAMPS = night.read_stamps()


def test_every_results_file_has_a_campaign_and_a_stamp() -> None:
    files = {file.stem for file in RESULTS.glob("*.json")} - {"stamps", "mutants_judged"}
    assert files == set(STAMPS) <= set(night.CAMPAIGNS)


@pytest.mark.parametrize("name", STAMPS)
def test_results_are_of_this_release(name: str) -> None:
    """After a new version every campaign is run anew: `make campaigns`."""
    assert STAMPS[name].version == __version__


@pytest.mark.parametrize("name", STAMPS)
def test_results_are_those_that_were_stamped(name: str) -> None:
    assert night.digest(RESULTS / f"{name}.json") == STAMPS[name].results


@pytest.mark.parametrize("name", STAMPS)
def test_the_page_has_the_stamp(name: str) -> None:
    page = PAGES / f"{night.CAMPAIGNS[name].page}.md"
    assert table_in_page(page, f"{name}-stamp") == STAMPS[name].line(name)


def test_a_campaign_that_fails_changes_nothing(tmp_path, monkeypatch, capsys) -> None:
    before = {file: file.read_bytes() for file in RESULTS.iterdir()}
    broken = night.Campaign("campaigns.night_of_nothing", ("packit_sim",), "soak", "")
    monkeypatch.setitem(night.CAMPAIGNS, "soak", broken)
    monkeypatch.setattr(night, "_git", lambda *arguments: "" if "status" in arguments else "0" * 40)
    assert night.run(["soak"], tmp_path) == ["soak"]
    assert "soak: failed" in capsys.readouterr().out
    assert {file: file.read_bytes() for file in RESULTS.iterdir()} == before
