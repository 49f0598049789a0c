"""Build the shape library "everyday" from the Sweet Home 3D furniture that Debian distributes.

    python scripts/build_everyday.py [--furniture DIR] [--out assets/everyday]

scripts/everyday.csv selects and names the models. The result is the same to the bit each time.
Needs meshoptimizer and scipy and, without --furniture, Debian's apt-get and dpkg-deb.
"""

from __future__ import annotations

import argparse
import csv
import html
import io
import math
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from zipfile import ZipFile

import meshoptimizer
import numpy as np
import numpy.typing as npt
import trimesh
from scipy.spatial import cKDTree

from packit_sim.library import Entry, ShapeLibrary
from packit_sim.quantized import QuantizedMesh
from packit_sim.shapes import Shape

VERSION = "1"
"""Of the library: raise it whenever a shape changes, since packs refer to it."""

PACKAGE = "sweethome3d-furniture"
SELECTION = Path(__file__).with_name("everyday.csv")
ASSETS = Path(__file__).resolve().parents[1] / "assets"

MAX_TRIANGLES = 4000

TOLERANCES = (1e-3, 3e-4, 1e-4)
"""In canonical units: a mesh is reduced until it is about the first of these off, and more only
where it still has too many triangles; the next is tried where more than `GOOD_ERROR` is lost."""

GOOD_ERROR = 0.005
"""In canonical units: half a cell for an item as long as the box."""

MAX_ERROR = 0.01
"""In canonical units: a shape that can't be kept this close has no place in the library."""

MIN_THICKNESS = 0.04
"""Least extent, in canonical units: what is thinner is a sheet."""

SAMPLES = 20_000
"""Points on a surface, beside all its vertices, where its distance to another is measured."""

NEIGHBOURS = (12, 60)
"""Samples near a point whose triangles may be the nearest: more for the points that seem far."""

LICENCES = {
    "CC0-1.0": "https://creativecommons.org/publicdomain/zero/1.0/",
    "CC-BY-3.0": "https://creativecommons.org/licenses/by/3.0/",
    "CC-BY-3.0-US": "https://creativecommons.org/licenses/by/3.0/us/",
}
"""The licences that the library takes, by SPDX identifier."""

MAKERS = {
    "KatorLegaz": "Andrew Kator & Jennifer Legaz",
    "Scopia": "Scopia Visual Interfaces Systems, s.l. and Emmanuel Puybaret / eTeks",
}
"""Whom the licences of these catalogues ask to name; the others name an author for each model."""

CONVERTED = "converted to OBJ by Emmanuel Puybaret / eTeks"


@dataclass(frozen=True)
class Model:
    """An entry of a catalogue. Sizes in cm; rotation (3, 3) turns the OBJ's own y-up frame."""

    archive: ZipFile
    catalogue: str
    properties: dict[str, str]

    @property
    def path(self) -> str:
        return self.properties["model"].lstrip("/")

    @property
    def size_cm(self) -> tuple[float, float, float]:
        x, y, z = (float(self.properties[key]) for key in ("width", "depth", "height"))
        return x, y, z

    @cached_property
    def terms(self) -> str:
        """Text of the licence: the model's own where it has one, else the catalogue's."""
        folder = self.path.rpartition("/")[0]
        names = [n for n in self.archive.namelist() if "license" in n.lower()]
        own = [n for n in names if n.startswith(folder + "/")]
        text = self.archive.read((own or ["LICENSE.TXT"])[0]).decode("latin-1")
        return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", text) + text).split())

    @property
    def licence(self) -> str:
        """SPDX identifier. Raises ValueError where the terms name none of `LICENCES`."""
        found = {
            "CC0-1.0": r"Creative Commons Zero",
            "CC-BY-3.0-US": r"Creative Commons Attribution 3\.0 United States",
            "CC-BY-3.0": r"Creative Commons Attribution 3\.0(?! United)",
        }
        names = [name for name, pattern in found.items() if re.search(pattern, self.terms)]
        if len(names) != 1:
            raise ValueError(f"{self.path}: its licence names {names or 'no licence we know'}")
        return names[0]

    @property
    def author(self) -> str:
        if self.catalogue in MAKERS:
            return MAKERS[self.catalogue]
        return f"{self.properties['creator']}, {CONVERTED}"

    @property
    def source(self) -> str:
        page = re.search(r"https?://(?:www\.)?blendswap\.com/blends?/(?:view/)?\d+", self.terms)
        return f"{self.catalogue}.sh3f: {self.path}" + (f", from {page[0]}" if page else "")

    def mesh(self) -> trimesh.Trimesh:
        """All its groups as one mesh: z up, in cm."""
        parts = trimesh.load_scene(
            io.BytesIO(self.archive.read(self.path)),
            file_type="obj",
            process=False,
            skip_materials=True,
        )
        mesh = parts.to_mesh()
        rotation = self.properties.get("modelRotation", "1 0 0 0 1 0 0 0 1")
        vertices = mesh.vertices @ np.array(rotation.split(), dtype=float).reshape(3, 3).T
        vertices = vertices[:, [0, 2, 1]] * (1, -1, 1)
        used = vertices[np.unique(mesh.faces)]
        vertices = (vertices - used.min(axis=0)) / np.ptp(used, axis=0) * self.size_cm
        return trimesh.Trimesh(vertices, mesh.faces, process=False)


def catalogue_models(archive: ZipFile, catalogue: str) -> dict[str, Model]:
    """The models of a catalogue, by the folder that each is in."""
    text = archive.read("PluginFurnitureCatalog.properties").decode("latin-1")
    properties: dict[str, dict[str, str]] = {}
    for key, number, value in re.findall(r"^\s*(\w+)#(\d+)\s*=\s*(.*?)\s*$", text, re.MULTILINE):
        properties.setdefault(number, {})[key] = value
    models = [Model(archive, catalogue, values) for values in properties.values()]
    return {model.path.split("/")[-2]: model for model in models}


def distance(points: npt.NDArray[np.float64], mesh: trimesh.Trimesh) -> float:
    """The largest distance of points (n, 3) to a surface: never too small, and rarely too large."""
    samples, faces = trimesh.sample.sample_surface(mesh, 4 * SAMPLES, seed=0)
    tree = cKDTree(np.concatenate([samples, mesh.triangles.reshape(-1, 3)]))
    owners = np.concatenate([faces, np.repeat(np.arange(len(mesh.faces)), 3)])
    gaps = np.ones(len(points))
    for neighbours in NEIGHBOURS:
        worst = np.flatnonzero(gaps > gaps.max() / 2)
        near = owners[tree.query(points[worst], k=neighbours)[1]]
        repeated = np.repeat(points[worst], neighbours, axis=0)
        closest = trimesh.triangles.closest_point(mesh.triangles[near.ravel()], repeated)
        gaps[worst] = np.linalg.norm(closest - repeated, axis=1).reshape(near.shape).min(axis=1)
    return float(gaps.max())


def deviation(a: trimesh.Trimesh, b: trimesh.Trimesh) -> float:
    """How far the vertices and samples of either surface are from the other, at most."""
    points = [
        np.concatenate([mesh.vertices, trimesh.sample.sample_surface(mesh, SAMPLES, seed=1)[0]])
        for mesh in (a, b)
    ]
    return max(distance(points[0], b), distance(points[1], a))


def reduced(mesh: trimesh.Trimesh, triangles: int, error: float) -> trimesh.Trimesh:
    """The same with as few triangles as this error allows, but no fewer than asked for."""
    indices = np.ascontiguousarray(mesh.faces, dtype=np.uint32).ravel()
    kept = np.empty_like(indices)
    count = meshoptimizer.simplify(
        kept,
        indices,
        np.ascontiguousarray(mesh.vertices, dtype=np.float32),
        target_index_count=3 * triangles,
        target_error=error,
        options=meshoptimizer.SIMPLIFY_ERROR_ABSOLUTE,
    )
    return trimesh.Trimesh(mesh.vertices, kept[:count].reshape(-1, 3).astype(int), process=False)


def entry(model: Model, id: str, category: str) -> Entry:
    """What the library holds of a model. Raises ValueError where it can't hold it."""
    source = Shape.from_mesh(model.mesh(), id, category)
    if source.extents.min() < MIN_THICKNESS:
        raise ValueError(f"{id}: only {source.extents.min():.3f} thick")
    error, shape = math.inf, source
    for tolerance in TOLERANCES:
        mesh = reduced(source.mesh, 0, tolerance)
        if len(mesh.faces) > MAX_TRIANGLES:
            mesh = reduced(source.mesh, MAX_TRIANGLES, 1.0)
        kept = QuantizedMesh.of(Shape.from_mesh(mesh, id, category)).mesh()
        off = deviation(source.mesh, kept)
        if off < error:
            error, shape = off, Shape(kept, id, category)
        if error <= GOOD_ERROR or len(mesh.faces) > 0.9 * MAX_TRIANGLES:
            break
    if error > MAX_ERROR or len(shape.mesh.faces) > MAX_TRIANGLES:
        raise ValueError(f"{id}: {error:.4f} off with {len(shape.mesh.faces)} triangles")
    return Entry(
        shape=shape,
        title=model.properties["name"],
        author=model.author,
        licence=model.licence,
        source=model.source,
        size_cm=model.size_cm,
        error_bound=float(f"{error + 5e-6:.5f}"),
    )


def licences_page(library: ShapeLibrary) -> str:
    """The attribution that the licences ask for, as Markdown."""
    lines = [
        f"# The shapes of the library {library.name!r}, version {library.version}",
        "",
        f"From Debian's package `{PACKAGE}` (Sweet Home 3D, https://www.sweethome3d.com). All are",
        "changed: geometry only, turned z up, scaled to diagonal 1, cleaned, reduced to at most",
        f"{MAX_TRIANGLES:,} triangles. Written by `scripts/build_everyday.py`.",
        "",
        *(f"- {name}: {url}" for name, url in LICENCES.items()),
        "",
        "| shape | category | title | author | licence | source |",
        "|---|---|---|---|---|---|",
    ]
    for info in map(library.info, library):
        cells = (info.id, info.category, info.title, info.author, info.licence, info.source)
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def download(folder: Path) -> Path:
    """Fetch and unpack Debian's package; returns its folder of catalogues."""
    subprocess.run(["apt-get", "download", PACKAGE], cwd=folder, check=True)
    (package,) = folder.glob("*.deb")
    subprocess.run(["dpkg-deb", "-x", str(package), str(folder)], check=True)
    return folder / "usr/share/sweethome3d/furniture"


def build(furniture: Path, out: Path) -> int:
    """Write the library and its page of licences; returns how many models were refused."""
    with SELECTION.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = sorted({row["catalogue"] for row in rows})
    catalogues = {
        name: catalogue_models(ZipFile(furniture / f"{name}.sh3f"), name) for name in names
    }
    entries, refused = [], 0
    for row in rows:
        try:
            model = catalogues[row["catalogue"]][row["model"]]
            entries.append(entry(model, row["id"], row["category"]))
        except ValueError as error:
            refused += 1
            print(f"refused: {error}", file=sys.stderr)
    ShapeLibrary.write(out, out.name, VERSION, entries)
    library = ShapeLibrary.open(out)
    out.with_name(f"{out.name}.md").write_text(licences_page(library), encoding="utf-8")
    print(f"{library} in {out}, digest {library.digest}")
    return refused


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--furniture", type=Path, help="folder of *.sh3f; downloaded by default")
    parser.add_argument("--out", type=Path, default=ASSETS / "everyday")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        furniture = options.furniture or download(Path(folder))
        sys.exit(1 if build(furniture, options.out) else 0)


if __name__ == "__main__":
    main()
