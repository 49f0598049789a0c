"""Groups of parts: together in a box, never in one box, or whole or not at all."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from trimesh import creation

from packit_sim import BoxType, Limits, PackedParts, PackSettings, Part, pack
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.filling.box_nesting import BoxNesting
from packit_sim.parts.filling.candidates import candidate
from packit_sim.parts.filling.groups import group_faults
from packit_sim.parts.reading.files import find_parts
from packit_sim.parts.results import exports
from packit_sim.parts.results.verification import verify_record

QUICK = PackSettings(workers=1, iterations=5)
RULES = [["together"], ["apart"], ["kit"], ["kit", "apart"], ["together", "apart"]]


@pytest.fixture(autouse=True)
def _no_pictures(monkeypatch) -> None:
    monkeypatch.setattr(exports, "draw", lambda packing, path, keep_out: path.write_bytes(b""))


def block(name: str, sides, count: int = 1, group: str | None = None, **settings) -> Part:
    return Part(name, creation.box(sides), count, group=group, **settings)


def contents(packed: PackedParts) -> list[Counter]:
    """How many parts of each group are in each box."""
    return [
        Counter(packed.part(one).part.group for one in packing.placements)
        for packing in packed.packings
    ]


def keeps(packed: PackedParts, rules: list[str]) -> bool:
    """Return whether the boxes keep the rules, counted anew."""
    boxes = [{group: k for group, k in own.items() if group} for own in contents(packed)]
    asked = Counter[str]()
    for each in packed.task.parts:
        if each.part.group:
            asked[each.part.group] += each.part.count
    whole = all(sum(group in box for box in boxes) <= 1 for group in asked)
    kits = all(box[group] == asked[group] for box in boxes for group in box)
    return (
        (whole or not {"together", "kit"} & set(rules))
        and (kits or "kit" not in rules)
        and (all(len(box) <= 1 for box in boxes) or "apart" not in rules)
    )


def random_parts(seed: int) -> list[Part]:
    rng = np.random.default_rng(seed)
    return [
        block(f"{group}{n}", rng.integers(6, 16, 3), int(rng.integers(1, 4)), group or None)
        for group in ("A", "B", "C", "D", "")
        for n in range(2)
    ]


@pytest.mark.parametrize("rules", RULES, ids="-".join)
def test_rules_are_kept_in_the_record_and_by_the_check(rules: list[str], tmp_path: Path) -> None:
    settings = replace(QUICK, groups=rules, boxes=2)
    packed = pack(random_parts(1), (32, 32, 32), settings=settings, out=tmp_path)
    assert packed.count > 8
    assert keeps(packed, rules)
    file = tmp_path / "packing.json"
    assert not verify_record(file).problems
    record = json.loads(file.read_text())
    assert record["request"]["groups"] == rules
    others = [n for n, box in enumerate(record["items"]) if box["name"].startswith(("A", "B"))]
    for part in record["request"]["parts"]:
        part["group"] = "A" if part["group"] == "D" else "D" if part["group"] == "A" else "B"
    changed = tmp_path / "changed.json"
    changed.write_text(json.dumps(record))
    found = [each.sentence for each in verify_record(changed).problems]
    assert others and any("group" in each or "kit" in each for each in found)
    again = pack(random_parts(1), (32, 32, 32), settings=settings, out=tmp_path)
    assert again.searches == 2 and again.count >= packed.count and keeps(again, rules)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rules", RULES, ids="-".join)
@pytest.mark.parametrize("objective", ["volume", "boxes"])
def test_rules_are_kept(rules: list[str], seed: int, objective) -> None:
    boxes = None if objective == "boxes" else 2
    packed = pack(
        random_parts(seed),
        (30, 26, 24),
        objective,
        settings=replace(QUICK, groups=rules, boxes=boxes),
    )
    assert packed.count > 0 and keeps(packed, rules)


def test_the_search_knows_kits() -> None:
    """Each kit fills more than half of the box: without the rule, all are begun."""
    kits = [block(f"{n}", (10, 10, 10 + n / 10), 14, f"kit {n}") for n in range(4)]
    free = pack(kits, (31, 31, 33), settings=QUICK)
    assert len(contents(free)[0]) > 1
    packed = pack(kits, (31, 31, 33), settings=replace(QUICK, groups=["kit"]))
    (inside,) = contents(packed)
    assert inside.total() == 14 and len(inside) == 1
    assert {each.reason for each in packed.left_out} == {"the whole kit does not fit"}
    assert [each.count for each in packed.left_out] == [14] * 3


def test_the_most_valuable_group_is_chosen() -> None:
    parts = [block(f"{n}", (10, 10, 10), 8, f"g{n}", value=n) for n in (1, 3, 2)]
    settings = replace(QUICK, groups=["apart"])
    packed = pack(parts, (21, 21, 21), "value", settings=settings)
    assert contents(packed) == [Counter({"g3": 8})]


def test_fewest_boxes_keep_groups_whole() -> None:
    parts = [block(f"{n}", (10, 10, 10), 12, f"g{n}") for n in range(4)]
    settings = replace(QUICK, groups=["together"])
    packed = pack(parts, (30, 30, 30), "boxes", settings=settings)
    assert [sorted(own.values()) for own in contents(packed)] == [[12, 12]] * 2
    settings = replace(QUICK, groups=["together", "apart"])
    packed = pack(parts, (30, 30, 30), "boxes", settings=settings)
    assert len(packed.packings) == 4 and not packed.left_out


def test_a_group_larger_than_a_box_is_cut_unless_it_is_a_kit() -> None:
    parts = [block("a", (10, 10, 10), 30, "A"), block("b", (10, 10, 10), 30, "B")]
    settings = replace(QUICK, groups=["together"], boxes=2)
    packed = pack(parts, (30, 30, 30), settings=settings)
    assert sorted(own.most_common(1)[0] for own in contents(packed)) == [("A", 27), ("B", 27)]
    with pytest.raises(ArgumentError, match="the kit 'A' fits into no box: its 30 parts are too"):
        pack(parts, (30, 30, 30), settings=replace(QUICK, groups=["kit"]))


def test_forty_groups_take_no_more_searches_than_there_is_time_for(monkeypatch) -> None:
    """Each search for a box drops some groups that are cut; after the time only shelves do."""
    searches: list[int] = []

    monkeypatch.setattr(BoxNesting, "nest", lambda *_: searches.append(1))
    parts = [block(f"{n}", (10, 10, 9 + n / 40), 3, f"g{n}") for n in range(40)]
    settings = replace(QUICK, groups=["kit"], boxes=2, iterations=None)
    packed = pack(parts, (31, 31, 41), time=1e-3, settings=settings)
    assert keeps(packed, ["kit"]) and sum(packed.counts.values()) > 30
    assert len(searches) <= 2


def test_impossible_groups_are_one_clear_error() -> None:
    cases = [
        ([block("a", (10, 10, 10))], ["kit"], "rules of groups need parts with a group"),
        ([block("a", (9, 9, 9), group="A")], ["mixed"], "rule of groups 'mixed' is not possible"),
        ([block("a", (9, 9, 50), group="A")], ["kit"], "the kit 'A' fits into no box: a of 9 x 9"),
        (
            [block("a", (9, 9, 9), 10_000, "A", as_many_as_fit=True)],
            ["kit"],
            "the kit 'A' needs a number of 'a', not max",
        ),
    ]
    for parts, rules, said in cases:
        parts.append(block("other", (5, 5, 5)))
        settings = PackSettings(workers=1, groups=rules) if rules != ["mixed"] else None
        with pytest.raises(ArgumentError, match=said):
            pack(parts, (30, 30, 30), settings=settings or PackSettings(groups=rules))
    light = BoxType((30, 30, 30), limits=Limits(max_parts=3))
    with pytest.raises(ArgumentError, match="the kit 'A' fits into no box: its 4 parts"):
        pack([block("a", (5, 5, 5), 4, "A")], light, settings=replace(QUICK, groups=["kit"]))


def test_candidates_lose_what_breaks_a_rule() -> None:
    parts = [block("a", (10, 10, 10), 4, "A"), block("b", (10, 10, 10), 30, "B")]
    free = pack(parts, (30, 30, 30), settings=replace(QUICK, boxes=2))
    task = replace(free.task, settings=replace(QUICK, groups=["together", "apart"]))
    found = candidate(task, free.packings)
    assert keeps(found, ["together", "apart"])
    assert {reason for _, reason in found.rejected} <= {
        *("its group is in another box", "its box has parts of another group")
    }
    assert found.count + len(found.rejected) == free.count


def test_faults_of_groups() -> None:
    groups = {"a": "A", "b": "B", "c": None}
    asked = {"a": 2, "b": 2, "c": 2}
    boxes = [Counter(a=1, b=1), Counter(a=1, c=2)]
    assert group_faults(["apart"], groups, asked, boxes) == [
        "box 1 has parts of the groups 'A' and 'B'"
    ]
    assert group_faults(["together"], groups, asked, boxes) == [
        "the group 'A' is in the boxes 1 and 2"
    ]
    assert group_faults(["kit"], groups, asked, boxes)[1:] == [
        "1 of 2 parts of the kit 'B' are packed"
    ]


def test_lists_of_parts_have_groups(tmp_path: Path) -> None:
    creation.box((1, 1, 1)).export(tmp_path / "a.stl")
    (tmp_path / "list.csv").write_text("file,Group\na.stl,order 7\na.stl,12\na.stl,\n")
    parts = find_parts([tmp_path / "list.csv"]).parts
    assert [each.group for each in parts] == ["order 7", "12", None]
