"""What can go wrong through no fault of the library: every error a user can meet.

Each message names the value (and the file, where there is one) and what would have been valid. An
operation that raises has changed nothing.
"""

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
]


class PackItError(Exception):
    """Base of every error that PackIt-Sim raises on purpose."""


class MeshError(PackItError, ValueError):
    """A mesh that is no shape: empty, not finite, or without extent along some axis."""


class LibraryError(PackItError, ValueError):
    """A shape library that can't be opened: missing, foreign, or damaged."""


class UnknownShapeError(PackItError, KeyError):
    """A shape id or category that the library doesn't hold."""

    def __str__(self) -> str:  # KeyError would show the message's repr
        return str(self.args[0])


class InfeasibleError(PackItError, ValueError):
    """A placement outside the grid or the box, or in conflict with what is already placed."""


class PackFormatError(PackItError, ValueError):
    """A pack or a dataset that can't be read: the message names file, line and field."""


class ArgumentError(PackItError, ValueError):
    """An argument or a setting whose value is not possible."""


class StateError(PackItError, RuntimeError):
    """A call that the state does not allow, such as a step after the end of an episode."""


class BusyError(PackItError, RuntimeError):
    """A file or folder that another process is at work on."""


class RenderError(PackItError, RuntimeError):
    """No picture could be made."""


class PhysicsError(PackItError, RuntimeError):
    """No simulation could be run, or no convex pieces made for one."""
