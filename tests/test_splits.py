"""The paper's rule for splits, with objects kept together."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from packit_sim.core.choices import SPLITS
from packit_sim.libraries.splits import divide


def named(counts: dict[str, int]) -> dict[str, str]:
    """The category of each of so many ids."""
    return {f"{name}/{n}": name for name, count in counts.items() for n in range(count)}


def sizes(splits: dict[str, tuple[str, ...]], category: str) -> list[int]:
    return [sum(id.startswith(f"{category}/") for id in splits[name]) for name in SPLITS]


def test_the_papers_rule() -> None:
    categories = named({"chair": 450, "mug": 300, "cap": 56, "bag": 2})
    splits = divide(categories, {id: id for id in categories}, seed=1)
    assert list(splits) == ["train", "test", "validation"]
    assert sizes(splits, "chair") == sizes(splits, "mug") == [100, 100, 100]
    assert sorted(sizes(splits, "cap")) == [18, 19, 19]
    assert sorted(sizes(splits, "bag")) == [0, 1, 1]
    assert sorted(len(ids) for ids in splits.values()) == [219, 219, 220]


def test_a_seed_repeats_and_categories_are_independent() -> None:
    categories = named({"chair": 400, "mug": 30})
    one, other = (divide(categories, {id: id for id in categories}, seed=s) for s in (1, 2))
    assert one == divide(categories, {id: id for id in categories}, seed=1)
    assert set(one["train"]) != set(other["train"])
    alone = named({"chair": 400})
    chairs = divide(alone, {id: id for id in alone}, seed=1)
    assert all(set(chairs[name]) <= set(one[name]) for name in SPLITS)


@given(
    st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 12)), min_size=1, max_size=60),
    st.integers(0, 2**32),
    st.integers(1, 20),
)
def test_no_object_is_torn_apart_and_none_is_in_two(
    shapes: list[tuple[str, int]], seed: int, most: int
) -> None:
    categories = {f"{category}{n}": category for n, (category, _) in enumerate(shapes)}
    groups = {f"{category}{n}": str(group) for n, (category, group) in enumerate(shapes)}
    splits = divide(categories, groups, seed, most)
    found = [{groups[id] for id in splits[name]} for name in SPLITS]
    assert not (found[0] & found[1] or found[0] & found[2] or found[1] & found[2])
    placed = set().union(*splits.values())
    assert all(id in placed for id in categories for other in placed if groups[id] == groups[other])
    if most >= len(shapes):
        assert placed == set(categories)


def test_a_split_of_no_shapes_is_refused() -> None:
    with pytest.raises(ValueError, match="max_shapes 0"):
        divide({"a": "b"}, {"a": "a"}, max_shapes=0)
