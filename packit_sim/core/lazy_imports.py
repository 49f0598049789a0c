"""Imports at the top of a module that are executed when they are first used.

A command line that only parses options, or prints help, has no use for what its commands work with.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import LazyLoader
from types import ModuleType

_LAZY = ("packit_sim", "packit_agents", "numpy", "rich")
"""Packages whose modules can wait; others are imported at once."""


class _LazyFinder(MetaPathFinder):
    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name.partition(".")[0] not in _LAZY:
            return None
        others = (finder for finder in sys.meta_path if finder is not self)
        found = (finder.find_spec(name, path, target) for finder in others)
        spec = next((one for one in found if one is not None), None)
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


@contextmanager
def lazy_imports() -> Iterator[None]:
    """Import modules in the block, which are executed when one of their names is first used.

    Write `from package import module` in it: `from package.module import name` uses the name, and
    executes the module at once. Type checkers and import-linter see usual imports.

    It is for modules of commands, which the main thread uses first: before Python 3.11.9 and 3.12.3
    two threads must not be the first to use a lazy module at the same time.

    Yields
    ------
    None
        For the imports.
    """
    finder = _LazyFinder()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
