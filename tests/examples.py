"""How many examples a costly property is tested with."""

from hypothesis import settings


def examples(count: int) -> settings:
    """Draw so many examples in `make test-all`; in `make test` a sixth, but at least three."""
    return settings(max_examples=max(3, count * settings.default.max_examples // 100))
