"""The errors that a user can cause.

Each message is one line with the value, the file if there is one, and the valid values. An
operation that raises has changed nothing. Errors that only one module raises are defined there, as
subclasses of `PackItError`.
"""

from collections.abc import Iterator
from contextlib import contextmanager

from packit_sim.core.plain_text import plain_line

__all__ = [
    "ArgumentError",
    "BusyError",
    "InfeasibleError",
    "LibraryError",
    "MeshError",
    "PackFormatError",
    "PackItError",
    "PhysicsError",
    "RenderError",
    "StateError",
    "UnknownShapeError",
    "about",
    "located",
    "reason",
]


class PackItError(Exception):
    """Base of all errors that PackIt-Sim raises for a user; the message is one plain line.

    Examples
    --------
    >>> from packit_sim import Box, PackItError
    >>> try:
    ...     Box((100, 100, 30))
    ... except PackItError as error:
    ...     print(error)
    a box of 100 x 100 x 30 cells is not possible: each must be a multiple of 4 from 4 to 512
    """

    def __str__(self) -> str:  # of a KeyError too, which would show the message's repr
        return plain_line(str(self.args[0]) if len(self.args) == 1 else super().__str__())


class MeshError(PackItError, ValueError):
    """A mesh that is not a shape: empty, not finite, or without extent along an axis."""


class LibraryError(PackItError, ValueError):
    """A shape library that can't be opened: missing, of another kind, or damaged."""


class UnknownShapeError(PackItError, KeyError):
    """A shape id or a category that the library does not contain."""


class InfeasibleError(PackItError, ValueError):
    """A placement outside the grid or the box, or in conflict with a placed item."""


class PackFormatError(PackItError, ValueError):
    """A pack or a dataset that can't be read; the message contains file, line and field."""


class ArgumentError(PackItError, ValueError):
    """An argument or a setting whose value is not possible.

    Attributes
    ----------
    setting : str
        The name of the setting that it is about, for a page with a field for it; "" if unknown.
    """

    setting = ""


class StateError(PackItError, RuntimeError):
    """A call that the state does not allow, such as a step after the end of an episode."""


class BusyError(PackItError, RuntimeError):
    """A file or folder that another process is writing."""


class RenderError(PackItError, RuntimeError):
    """A picture or file that can't be drawn or written."""


class PhysicsError(PackItError, RuntimeError):
    """A simulation that can't run, or a shape that can't be decomposed for one."""


@contextmanager
def located(where: object, kind: type[PackItError]) -> Iterator[None]:
    """Put a place in front of the message of an error that is raised within the block.

    Parameters
    ----------
    where : object
        The place, such as a file, or a file and a line.

    Yields
    ------
    None
        To the block.

    Raises
    ------
    PackItError
        The same type of error, with the longer message.
    """
    try:
        yield
    except kind as error:
        raise kind(f"{where}: {error}") from None


@contextmanager
def about(setting: str) -> Iterator[None]:
    """Note the name of the setting that an ArgumentError within the block is about.

    Yields
    ------
    None
        To the block.
    """
    try:
        yield
    except ArgumentError as error:
        error.setting = error.setting or setting
        raise


def reason(error: Exception) -> str:
    """Return the message of an error, after the name of its type if it is not one of ours."""
    return str(error) if isinstance(error, PackItError) else f"{type(error).__name__}: {error}"


def message(error: PackItError | OSError) -> str:
    """Return the message of an error for its user: with the path, if it is one of the disk."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return str(error)
