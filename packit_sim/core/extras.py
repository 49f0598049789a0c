"""Optional packages: which extra installs them, and the error if one is missing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from packit_sim.core.errors import PackItError

EXTRAS = {
    "cascadio": "cad",
    "coacd": "physics",
    "h5py": "learn",
    "imageio_ffmpeg": "view",
    "manifold3d": "containers",
    "matplotlib": "report",
    "minari": "learn",
    "pybullet": "physics",
    "pybullet_data": "physics",
    "python_calamine": "sheets",
    "pysat": "exact",
    "ray": "cluster",
    "sb3_contrib": "learn",
    "stable_baselines3": "learn",
    "tensorboard": "learn",
    "torch": "learn",
    "viser": "view",
}
"""The extra of PackIt-Sim that installs each optional package, by the name that is imported."""


class MissingPackageError(PackItError, ImportError):
    """An optional package that is needed and not installed; the message names the extra."""


@contextmanager
def needed_for(purpose: str, alternative: str = "") -> Iterator[None]:
    """Import optional packages within the block, with a helpful error if one is missing.

    Parameters
    ----------
    purpose : str
        The feature that needs them, a plural noun: the subject of the message.
    alternative : str
        An alternative to installing them.

    Yields
    ------
    None
        To the block.

    Raises
    ------
    MissingPackageError
        If an import in the block fails; the message contains the command that installs the extra.
    """
    try:
        yield
    except MissingPackageError:
        raise
    except ImportError as error:
        package = (error.name or "").partition(".")[0]
        if not isinstance(error, ModuleNotFoundError):
            raise MissingPackageError(
                f"{purpose} need {package or 'a package'}, which can't be imported: {error}"
            ) from error
        message = f"{purpose} need {package}, which is not installed"
        if package in EXTRAS:
            message += f": pip install 'packit-sim[{EXTRAS[package]}]'"
        if alternative:
            message += f", or {alternative}"
        raise MissingPackageError(message) from error
