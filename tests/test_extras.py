"""A missing optional package is an error that contains the command to install it."""

import sys
import tomllib
from pathlib import Path

import pytest

from packit_sim.core import extras, version
from packit_sim.core.extras import MissingPackageError, needed_for

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]

DISTRIBUTIONS = {
    "h5py": "minari[hdf5]",
    "minari": "minari[hdf5]",
    "pybullet_data": "pybullet",
    "pysat": "python-sat",
}
"""Where the name to install differs from the name to import by more than a hyphen."""


@pytest.mark.parametrize(("package", "extra"), extras.EXTRAS.items())
def test_each_extra_installs_its_packages(package: str, extra: str) -> None:
    names = [line.partition(">=")[0] for line in PROJECT["optional-dependencies"][extra]]
    assert DISTRIBUTIONS.get(package, package.replace("_", "-")) in names


def test_the_message_has_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(MissingPackageError) as raised, needed_for("trainings", "play instead"):
        import stable_baselines3.common  # noqa: F401
    assert str(raised.value) == (
        "trainings need stable_baselines3, which is not installed: "
        "pip install 'packit-sim[learn]', or play instead"
    )


def test_a_package_of_no_extra_is_named() -> None:
    message = "^agents need packit_absent, which is not installed$"
    with pytest.raises(MissingPackageError, match=message), needed_for("agents"):
        import packit_absent  # noqa: F401


def test_a_broken_package_is_not_called_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "packit_broken.py").write_text("raise ImportError('no libX', name='libX')")
    monkeypatch.syspath_prepend(tmp_path)
    message = "pages need libX, which can't be imported: no libX"
    with pytest.raises(MissingPackageError, match=message), needed_for("pages"):
        import packit_broken  # noqa: F401


def test_the_address_is_that_of_the_metadata() -> None:
    assert PROJECT["urls"]["Documentation"] == version.DOCUMENTATION
