"""Sums that reach files are the same on every Python."""

import ast
from functools import reduce
from operator import add
from pathlib import Path

import numpy as np

import packit_sim
from packit_sim.core.sums import plain_sum


def test_a_sum_is_rounded_after_each_term() -> None:
    """With the built-in `sum`, it is 0.9999999999999999 on Python 3.11 and 1.0 on 3.12."""
    assert plain_sum([0.1] * 10) == 0.9999999999999999
    assert plain_sum([]) == 0.0
    for terms in np.random.default_rng(0).random((50, 20)).tolist():
        assert plain_sum(iter(terms)) == reduce(add, terms)


def test_volumes_and_rewards_are_not_added_by_sum() -> None:
    """The check of results may: it compares with a tolerance."""
    words = {"volume", "volumes", "reward", "rewards"}
    for file in sorted(Path(packit_sim.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "sum":
                names = {getattr(part, "attr", getattr(part, "id", "")) for part in ast.walk(node)}
                assert not words & names or file.name == "result_checks.py", file
