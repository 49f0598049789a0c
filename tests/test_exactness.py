"""Random cases compared with the oracle at all locations of the box; any number of cases.

    make test-all MASKS=2000 SEED=1

`packit selftest` makes the same checks for as long as it may.
"""

from __future__ import annotations

import pytest

from packit_sim.selftest.case_runs import run_case


@pytest.mark.slow
def test_the_engine_agrees_with_the_oracle(mask_seed: tuple[int, int]) -> None:
    outcome = run_case(*mask_seed)
    assert outcome.counts["locations"] > 0
    assert outcome.differences == [], outcome.replay
