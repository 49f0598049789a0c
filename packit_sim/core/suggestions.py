"""Suggestions for names that are not known."""

from collections.abc import Iterable
from difflib import get_close_matches

_LIKENESS = 0.7
"""Smallest likeness of a name that is suggested, from 0 to 1."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Suggest the known names that are most like one that is not, for a message.

    Returns
    -------
    str
        A question and a space; empty if none is like it.

    Examples
    --------
    >>> from packit_sim.core.suggestions import did_you_mean
    >>> did_you_mean("largest-frist", ["largest-first", "random"])
    'did you mean largest-first? '
    """
    close = get_close_matches(name, known, 2, _LIKENESS)
    return f"did you mean {' or '.join(close)}? " if close else ""
