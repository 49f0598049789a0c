"""Write the tables of docs/trust/dependencies.md: each dependency, its reason and its licence.

    python scripts/dependencies.py

Licences come from the metadata of the packages that are installed here, so that all extras must be
(`make setup EXTRAS=dev,cluster,bench`); a package that is not keeps what the page says. The reasons
are below.
"""

from __future__ import annotations

import re
import tomllib
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "trust" / "dependencies.md"

REASONS = {
    "atheris": "fuzzes the readers of files",
    "build": "builds the sdist and the wheel",
    "cachetools": "caches with a budget of bytes",
    "cascadio": "tessellates STEP files, by OpenCASCADE",
    "check-jsonschema": "checks the CI workflows and the citation file",
    "coacd": "decomposes meshes into convex pieces for physics",
    "coverage": "measures which lines the tests execute",
    "deap": "tournament selection, for one comparison of searches",
    "fast-simplification": "reduces triangles when meshes are imported",
    "filelock": "one process writes a file at a time",
    "furo": "theme of the documentation site",
    "gymnasium": "the interface of the environments",
    "hatchling": "build backend",
    "hypothesis": "property tests",
    "imageio-ffmpeg": "ffmpeg, for MP4 films",
    "import-linter": "checks that imports run downwards",
    "jinja2": "HTML pages: packings, instructions, reports",
    "joblib": "local worker processes",
    "lazy-loader": "imports public names when they are first used",
    "lib3mf": "reads 3MF files; it is the 3MF Consortium's own library",
    "lxml": "reads XML: 3MF and COLLADA; external entities are refused",
    "manifold3d": "mesh containers; volumes of intersections, as an independent check",
    "matplotlib": "plots",
    "minari": "recorded demonstrations",
    "mlcroissant": "validates the Croissant metadata of archives, in tests",
    "msgspec": "decodes JSON into typed records",
    "mypy": "checks types",
    "myst-parser": "documentation in Markdown",
    "networkx": "trimesh reads scenes (COLLADA, glTF) and finds connected parts with it",
    "numba": "compiles the kernels of the placement engine",
    "numpy": "arrays",
    "openpyxl": "writes spreadsheets in tests",
    "packvium": "a bin packer, for a comparison",
    "pebble": "imports each mesh in a worker process with a limit of time",
    "pillow": "pictures: PNG, GIF, text",
    "platformdirs": "where the user's cache folder is",
    "playwright": "tests pages in a browser",
    "pre-commit": "runs the checks before a commit",
    "pybullet": "physics, and pictures by OpenGL",
    "pycollada": "trimesh reads COLLADA with it",
    "pydoclint": "checks that docstrings name no parameter that does not exist",
    "pytest": "runs the tests",
    "pytest-timeout": "ends a test that hangs",
    "pytest-xdist": "tests on several cores",
    "python-calamine": "reads lists of parts in .xlsx",
    "python-fcl": "exact collision of meshes",
    "python-sat": "solves exact cover with polycubes, by CaDiCaL",
    "ray": "jobs on a cluster",
    "rich": "tables and progress in the terminal",
    "ruff": "format and rules of the code",
    "safetensors": "network weights without code",
    "sb3-contrib": "PPO with invalid actions masked",
    "scipy": "convex hulls, nearest neighbours, sparse graphs",
    "sphinx": "documentation site",
    "sphinx-copybutton": "a copy button on examples",
    "sphinx-design": "cards and tabs on the site",
    "sphinx-gallery": "the gallery of examples",
    "stable-baselines3": "the training loop of PPO",
    "tensorboard": "learning curves while a training runs",
    "torch": "networks",
    "trimesh": "reads meshes, and their topology",
    "typer": "the command line",
    "types-cachetools": "type hints of cachetools",
    "viser": "the interactive 3D viewer",
    "websockets": "the viewer's connection, with its check of the origin",
    "zizmor": "checks the CI workflows for security",
}
"""Why each dependency is needed."""

_SHORT = {
    "MIT License": "MIT",
    "BSD License": "BSD",
    "Apache Software License": "Apache-2.0",
    "GNU Library or Lesser General Public License (LGPL)": "LGPL-3.0",
    "Python Software Foundation License": "Matplotlib (PSF-like)",
    "Apache 2.0": "Apache-2.0",
    "zlib/libpng License": "zlib",
    "3-clause BSD": "BSD-3-Clause",
}


def dependencies() -> dict[str, list[str]]:
    """Read the names of dependencies from pyproject.toml, by extra; "base" are those of all."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    groups = {"base": project["dependencies"], **project["optional-dependencies"]}
    return {
        group: sorted({_name(requirement) for requirement in requirements} - {"packit-sim"})
        for group, requirements in groups.items()
    }


def _name(requirement: str) -> str:
    found = re.match(r"[\w.-]+", requirement)
    assert found is not None
    return found[0].lower()


def rows(page: str) -> dict[str, tuple[str, str, str]]:
    """Read a page's table: reason, licence and extras by the name of the dependency."""
    found = re.findall(r"^\| `([\w.-]+)` \| (.*?) \| (.*?) \| (.*?) \|$", page, re.MULTILINE)
    return {name: (reason, licence, extras) for name, reason, licence, extras in found}


def table(known: dict[str, tuple[str, str, str]]) -> str:
    """Write the table; packages that are not installed keep the licence that is known."""
    groups = dependencies()
    names = sorted({name for own in groups.values() for name in own})
    names.sort(key=lambda name: name not in groups["base"])
    lines = ["| package | for | licence | installed by |", "|---|---|---|---|"]
    for name in names:
        extras = ", ".join(group for group, own in groups.items() if name in own)
        licence = _licence(name) or known[name][1]
        lines.append(f"| `{name}` | {REASONS[name]} | {licence} | {extras} |")
    return "\n".join(lines) + "\n"


def _licence(name: str) -> str | None:
    """Return what a package's metadata says of its licence; None if nothing or not installed."""
    try:
        found = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return None
    said: list[str] = found.get_all("License-Expression", [])
    classifiers = found.get_all("Classifier", [])
    said += [line.split(" :: ")[-1] for line in classifiers if line.startswith("License :: OSI A")]
    said += [text.splitlines()[0] for text in found.get_all("License", [])]
    return _SHORT.get(said[0], said[0]) if said else None


def main() -> None:
    page = PAGE.read_text(encoding="utf-8")
    written = re.sub(
        r"(?<=<!-- table -->\n).*?(?=<!-- end -->)", table(rows(page)), page, flags=re.DOTALL
    )
    PAGE.write_text(written, encoding="utf-8")


if __name__ == "__main__":
    main()
