"""How many examples a costly property is tested with, and where the costly ones are tested."""

import pytest
from hypothesis import settings

OFTEN_OPENED = ["software", pytest.param("egl", marks=pytest.mark.slow)]
"""Values of the fixture `renderer` for tests of many worlds: EGL takes a second for each."""


def examples(count: int) -> settings:
    """Draw so many examples in `make test-all`; in `make test` a sixth, but at least three."""
    return settings(max_examples=max(3, count * settings.default.max_examples // 100))
