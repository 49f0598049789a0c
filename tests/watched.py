"""Recorded calls of functions, for tests of what a program makes."""

from __future__ import annotations

import functools
import pkgutil
from typing import Any

import pytest


class Watched:
    """A function that records what it returns, in place of the one of that name.

    Parameters
    ----------
    monkeypatch : pytest.MonkeyPatch
        Puts the function back after the test.
    owner : object
        The module or the object whose function it is, or the dotted name of a module.
    name : str
        Its name.

    Attributes
    ----------
    calls : list of tuple
        The arguments of the calls.
    returned : list
        What they returned.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.returned: list[Any] = []
        if isinstance(owner, str):
            owner = pkgutil.resolve_name(owner)
        function = getattr(owner, name)

        @functools.wraps(function, updated=())
        def watched(*arguments: Any) -> Any:
            self.calls.append(arguments)
            self.returned.append(function(*arguments))
            return self.returned[-1]

        monkeypatch.setattr(owner, name, watched)
