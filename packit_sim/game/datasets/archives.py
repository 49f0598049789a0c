"""Archives of datasets and libraries, as data hosts take them: files, metadata and a ZIP file."""

from __future__ import annotations

import hashlib
import io
import json
import re
import textwrap
import zipfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from packit_sim.core import templates
from packit_sim.core.choices import SPLITS
from packit_sim.core.errors import ArgumentError
from packit_sim.core.files import replacing, require_same
from packit_sim.core.version import DOCUMENTATION, __version__
from packit_sim.game.datasets import datasheet
from packit_sim.game.datasets.builtin import BUILTIN_DATASETS
from packit_sim.game.datasets.croissant import Metadata, Records, croissant
from packit_sim.game.datasets.datasheet import PAPER
from packit_sim.game.datasets.manifests import find_manifest
from packit_sim.game.datasets.pack_files import dataset_path
from packit_sim.libraries.library import ShapeLibrary, builtin_names
from packit_sim.libraries.sources import ShapeInfo

AUTHOR = "PackIt-Sim contributors"

BUILTIN_LICENCE = "CC0-1.0"
"""The licence of the packs of all built-in datasets."""

METADATA = "croissant.json"

CARD = "README.md"

ATTRIBUTION = "ATTRIBUTION.md"

PICTURE = "statistics.png"
"""The picture of the statistics of a dataset."""

CHECKSUMS = "SHA256SUMS"

KEYWORDS = "3D packing", "bin packing", "geometric planning", "meshes", "reinforcement learning"

_TEMPLATE = Path(__file__).with_name("library_card.md.jinja")

_PACK_TYPES = {"density": "sc:Float", "format": "sc:Integer", "version": "sc:Text"}

_SHAPE_TYPES = {
    **dict.fromkeys(("id", "category", "title", "author", "licence", "source"), "sc:Text"),
    "triangles": "sc:Integer",
    **dict.fromkeys(("watertight", "solid"), "sc:Boolean"),
    **dict.fromkeys(("volume", "error_bound"), "sc:Float"),
    **dict.fromkeys(("group", "digest"), "sc:Text"),
}

_ZIP_DATE = (1980, 1, 1, 0, 0, 0)
"""The date of all files in a ZIP file, so that equal data give equal archives."""

_MAINTENANCE = (
    "A version is never changed: new content has a new digest. Packs and results record the "
    "digests of what they refer to."
)

_IMPACT = (
    "The data are for research on packing. Results in simulation don't show that a robot can pack "
    "safely."
)


def dataset_archive(
    source: Path | str,
    library: ShapeLibrary,
    date: str,
    licence: str = "",
    author: str = "",
) -> tuple[Metadata, str]:
    """Describe a dataset and collect its files.

    Parameters
    ----------
    source : Path or str
        The dataset's name or path.
    library : ShapeLibrary
        The library of its shapes.
    date : str
        When it is published, as YYYY-MM-DD.
    licence : str
        The SPDX identifier of its licence; known for built-in datasets.
    author : str
        Its author; known for built-in datasets.

    Returns
    -------
    metadata : Metadata
        Its description, with the files, but without `PICTURE`, which its page shows.
    card : str
        Its page in Markdown: the datasheet.

    Raises
    ------
    ArgumentError
        If the licence or the author is neither known nor given.
    """
    known = str(source) in BUILTIN_DATASETS
    licence = licence or (BUILTIN_LICENCE if known else "")
    author = author or (AUTHOR if known else "")
    for what, value in (("licence", licence), ("author", author)):
        if not value:
            raise ArgumentError(f"the {what} of {source} is not known: name it (--{what})")
    parts = datasheet.read(source, library)
    card = datasheet.page(
        source, parts, library, picture=PICTURE, licence=licence, opened_as=library.locator
    )
    folder = dataset_path(source)
    name = folder.name if folder.is_dir() else folder.stem
    files = {}
    for part in parts:
        data = part.file.read_bytes()
        files[part.file.name] = data
        if (manifest := find_manifest(part.file, data)) is not None:
            files[manifest.name] = manifest.read_bytes()
    if library.path.absolute().is_relative_to(folder.absolute()):
        files |= _tree(library.path, f"{library.path.name}/")
    packs = sum(part.statistics.packs for part in parts)
    commands = [part.command(library.locator, name) for part in parts]
    made = "; ".join(f"`{command}`" for command in commands if command)
    frequent = "; ".join(part.statistics.rows()["most frequent"] for part in parts)
    frequent = ", ".join(frequent.splitlines())
    return Metadata(
        name=name,
        title=f"{name}: packing tasks of PackIt-Sim",
        summary=f"{packs} packs of shapes of the library {library.name}: "
        f"{BUILTIN_DATASETS.get(str(source), 'boxes filled with 3D meshes')}. Each pack is a "
        "filled box, and its items are a task whose solution is known.",
        author=author,
        version=_version(_digest(files)),
        date=date,
        licences=(licence,),
        keywords=KEYWORDS,
        responsible_ai={
            "dataCollection": "A program, PackIt-Sim, generated the packs from shapes of the "
            f"library {library.name} with the digest {library.digest}. {made}",
            "dataCollectionType": ["Software collection"],
            "dataPreprocessingProtocol": ["Each box was compared with a slow, exact check."],
            "dataUseCases": [f"Training and evaluation of agents that pack boxes, as in {PAPER}."],
            "dataBiases": [f"Some categories are more frequent than others: {frequent}."],
            "dataLimitations": _limits(card),
            **_general(library),
        },
        records=tuple(Records(part.split, part.file.name, _PACK_TYPES) for part in parts),
        files=files,
    ), card


def library_archive(library: ShapeLibrary, date: str, author: str = "") -> tuple[Metadata, str]:
    """Describe a stored library and collect its files.

    Parameters
    ----------
    library : ShapeLibrary
        The library.
    date : str
        When it is published, as YYYY-MM-DD.
    author : str
        Who publishes it; known for built-in libraries.

    Returns
    -------
    metadata : Metadata
        Its description, with the files.
    card : str
        Its page in Markdown.

    Raises
    ------
    ArgumentError
        If it is not a stored library, a licence is not recorded, or the author is not known.
    """
    known = library.locator in builtin_names()
    author = author or (AUTHOR if known else "")
    if not library.source.is_catalogued:
        raise ArgumentError(
            f"{library.path} is no stored library: `packit shapes import` makes one"
        )
    if not author:
        raise ArgumentError(f"the author of {library.path} is not known: name it (--author)")
    infos = [library.info(id) for id in library]
    unknown = [info.id for info in infos if not info.licence]
    if unknown:
        raise ArgumentError(f"{library.path} does not record the licence of shape {unknown[0]!r}")
    licences = Counter(info.licence for info in infos).most_common()
    origins = Counter(info.source.partition(":")[0] or author for info in infos).most_common()
    categories = [(name, len(ids)) for name, ids in library.categories.items()]
    solid = sum(info.solid for info in infos)
    processing = (
        "Geometry only, without materials. Each mesh is in a canonical frame: centred, z up, its "
        "bounding box with a diagonal of 1. A surface is nowhere farther from the mesh that was "
        f"imported than its error_bound, at most {max(info.error_bound for info in infos):g}."
    )
    limits = [
        f"{len(infos) - solid} of {len(infos)} meshes are not one closed body: their volumes are "
        "those of solids by voxels.",
        "Categories have different numbers of shapes.",
        "These are not the shapes of ShapeNet.",
    ]
    title = f"{library.name}: a library of shapes of PackIt-Sim"
    summary = f"{len(infos)} triangle meshes of objects in {len(categories)} categories."
    card = templates.render(
        _TEMPLATE,
        {
            "title": title,
            "summary": summary,
            "digest": library.digest,
            "splits": [(name, len(library.split(name))) for name in SPLITS],
            "watertight": sum(info.watertight for info in infos),
            "solid": solid,
            "categories": categories,
            "licences": licences,
            "origins": origins,
            "processing": processing,
            "limits": limits,
        },
        filters={"wrap": _wrapped},
    )
    return Metadata(
        name=f"{library.name}-shapes",
        title=title,
        summary=summary,
        author=author,
        version=_version(library.digest),
        date=date,
        licences=tuple(name for name, _ in licences),
        keywords=KEYWORDS,
        responsible_ai={
            "dataCollection": "Meshes from other collections or programs: "
            + ", ".join(f"{name} ({count})" for name, count in origins),
            "dataCollectionType": ["Secondary data analysis", "Software collection"],
            "dataPreprocessingProtocol": [processing],
            "dataAnnotationProtocol": ["Titles and sizes are those of the origins, if known."],
            "dataUseCases": ["Items of packing tasks."],
            "dataBiases": [limits[1]],
            "dataLimitations": limits,
            **_general(library),
        },
        records=(Records("shapes", "library.json", _SHAPE_TYPES, "$.shapes[*]"),),
        files={**_tree(library.path, ""), ATTRIBUTION: _attribution(title, infos).encode()},
    ), card


def write_archive(metadata: Metadata, card: str, folder: Path) -> Path:
    """Write an archive: a folder, and the same as a ZIP file next to it.

    Parameters
    ----------
    metadata : Metadata
        The description, with the files.
    card : str
        The page of the data.
    folder : Path
        The folder, which is created; it must be empty.

    Returns
    -------
    Path
        The ZIP file, which is the same for the same data and date.

    Raises
    ------
    ArgumentError
        If the folder has files, or the ZIP file exists with other content.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ArgumentError(f"{folder} is not an empty folder: choose another --out")
    texts = {
        METADATA: json.dumps(croissant(metadata), ensure_ascii=False, indent=1) + "\n",
        CARD: _front_matter(metadata) + card,
        "CITATION.cff": _citation(metadata),
        ".zenodo.json": json.dumps(_zenodo(metadata), ensure_ascii=False, indent=1) + "\n",
    }
    files = {**metadata.files, **{name: text.encode() for name, text in texts.items()}}
    sums = "".join(
        f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in sorted(files.items())
    )
    files[CHECKSUMS] = sums.encode()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in sorted(files.items()):
            entry = zipfile.ZipInfo(f"{metadata.name}/{name}", _ZIP_DATE)
            archive.writestr(entry, data, zipfile.ZIP_DEFLATED)
    whole = folder.with_name(f"{folder.name}.zip")
    require_same(whole, packed.getvalue())
    for name, data in sorted(files.items()):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    with replacing(whole) as file:
        file.write(packed.getvalue())
    return whole


def _front_matter(metadata: Metadata) -> str:
    """Write the head of a card as Hugging Face reads it."""
    lines = ["---", f"pretty_name: {json.dumps(metadata.title)}"]
    if len(metadata.licences) == 1:
        lines.append(f"license: {metadata.licences[0].lower()}")
    else:
        lines += ["license: other", "license_name: several", f"license_link: {ATTRIBUTION}"]
    lines += ["tags:", *(f"- {word.lower()}" for word in metadata.keywords)]
    tables = [records for records in metadata.records if not records.json_path]
    if tables:
        lines += ["configs:", "- config_name: default", "  data_files:"]
        lines += [
            line for one in tables for line in (f"  - split: {one.name}", f"    path: {one.file}")
        ]
    return "\n".join([*lines, "---", "", ""])


def _citation(metadata: Metadata) -> str:
    """Write a citation file; JSON's strings are YAML's."""
    quoted = json.dumps
    licences = ", ".join(metadata.licences)
    return "\n".join(
        [
            "cff-version: 1.2.0",
            "message: If you use these data, please cite them.",
            "type: dataset",
            f"title: {quoted(metadata.title, ensure_ascii=False)}",
            "authors:",
            f"  - name: {quoted(metadata.author, ensure_ascii=False)}",
            f"version: {quoted(metadata.version)}",
            f"date-released: {quoted(metadata.date)}",
            f"license: [{licences}]",
            f"url: {DOCUMENTATION}",
            "",
        ]
    )


def _zenodo(metadata: Metadata) -> dict[str, Any]:
    """Return the metadata by which Zenodo fills its form; it takes one licence."""
    one = len(metadata.licences) == 1
    return {
        "title": metadata.title,
        "upload_type": "dataset",
        "description": metadata.summary,
        "creators": [{"name": metadata.author}],
        "version": metadata.version,
        "publication_date": metadata.date,
        "license": metadata.licences[0].lower() if one else "other-open",
        "notes": "" if one else f"Each shape has its own licence: see {ATTRIBUTION}.",
        "keywords": list(metadata.keywords),
        "access_right": "open",
    }


def _general(library: ShapeLibrary) -> Mapping[str, str | list[str]]:
    """Return what holds for all data: impact, maintenance, and what is known about people."""
    known = library.locator in builtin_names()
    personal = f"Unknown: PackIt-Sim has not examined the shapes of {library.name}."
    return {
        "dataSocialImpact": _IMPACT,
        "personalSensitiveInformation": [
            "None: shapes of objects, without data about people." if known else personal
        ],
        "dataReleaseMaintenancePlan": _MAINTENANCE,
    }


def _limits(card: str) -> list[str]:
    """Return the list of known limits at the end of a datasheet."""
    section = card.partition("## Known limits")[2]
    return [" ".join(text.split()) for text in re.split(r"^- ", section, flags=re.MULTILINE)[1:]]


def _attribution(title: str, infos: list[ShapeInfo]) -> str:
    rows = (
        " | ".join(
            text.replace("|", "\\|")
            for text in (f"`{one.id}`", one.title, one.author, one.licence, one.source)
        )
        for one in infos
    )
    head = f"# {title}\n\n| id | title | author | licence | source |\n|---|---|---|---|---|\n"
    return head + "".join(f"| {row} |\n" for row in rows)


def _tree(folder: Path, prefix: str) -> dict[str, bytes]:
    """Read all files of a folder, by their paths from there."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {prefix + path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def _digest(files: Mapping[str, bytes]) -> str:
    """Compute the digest of a set of files of packs."""
    packs = {name: data for name, data in files.items() if name.endswith(".jsonl")}
    lines = (f"{hashlib.sha256(data).hexdigest()} {name}\n" for name, data in packs.items())
    return hashlib.sha256("".join(sorted(lines)).encode()).hexdigest()


def _version(digest: str) -> str:
    """Return the version of data: that of PackIt-Sim, with the digest as build metadata."""
    return f"{__version__}+{digest[:12]}"


def _wrapped(text: str, indent: str = "") -> str:
    return textwrap.fill(text, datasheet.WIDTH, subsequent_indent=indent)
