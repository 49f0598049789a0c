"""Each dependency has a reason and a licence in the documentation."""

import pytest

from scripts import dependencies

KNOWN = dependencies.rows(dependencies.PAGE.read_text(encoding="utf-8"))


def test_the_table_and_the_project_agree() -> None:
    groups = dependencies.dependencies()
    names = {name for group in groups.values() for name in group}
    assert set(KNOWN) == set(dependencies.REASONS) == names
    for name, (reason, licence, extras) in KNOWN.items():
        assert reason == dependencies.REASONS[name] and licence
        assert extras.split(", ") == [group for group, own in groups.items() if name in own]


def test_the_command_writes_the_table_that_is_there() -> None:
    page = dependencies.PAGE.read_text(encoding="utf-8")
    names = [line.split("`")[1] for line in dependencies.table(KNOWN).splitlines()[2:]]
    assert names == list(KNOWN)
    assert f"PackIt-Sim needs {len(dependencies.dependencies()['base'])} packages" in page


def test_a_dependency_without_a_reason_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(dependencies.REASONS, "numpy")
    with pytest.raises(KeyError, match="numpy"):
        dependencies.table(KNOWN)
