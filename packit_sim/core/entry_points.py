"""Entry points: what installed packages announce, such as commands, agents and shape sources."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from packit_sim.core.errors import PackItError, reason
from packit_sim.core.extras import needed_for

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


class EntryPointError(PackItError, ImportError):
    """An entry point that can't be used; the message contains its package and the reason."""


def announced(group: str) -> dict[str, EntryPoint]:
    """Find the entry points of a group, sorted by name; this takes about 10 ms."""
    from importlib.metadata import entry_points  # `packit --version` does not need it

    found = entry_points(group=group)
    return {name: found[name] for name in sorted(found.names)}


def load(point: EntryPoint, kind: str) -> Any:
    """Import the object of an entry point.

    Parameters
    ----------
    kind : str
        What it announces, for the message, such as "search".

    Returns
    -------
    object
        The object.

    Raises
    ------
    EntryPointError
        If that is not possible, whatever its package raises.
    """
    with usable(point, kind), needed_for("its imports"):
        return point.load()


@contextmanager
def usable(point: EntryPoint, kind: str) -> Iterator[None]:
    """Name an entry point in any error that its use in the block raises.

    Yields
    ------
    None
        To the block.

    Raises
    ------
    EntryPointError
        If the block raises anything, even SystemExit; Ctrl-C still ends the program.
    """
    try:
        yield
    except (Exception, SystemExit) as error:
        package = getattr(point.dist, "name", None) or "a package without a name"
        why = reason(error) if isinstance(error, Exception) else "it ends the program"
        raise EntryPointError(
            f"the {kind} {point.name!r} of {package} can't be used: {why}"
        ) from error
