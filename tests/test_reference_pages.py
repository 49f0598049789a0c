"""The pages of the reference list exactly the fields and settings of the code."""

import dataclasses
import inspect
import json
import re
from pathlib import Path
from typing import Any

import gymnasium
import msgspec
import numpy as np
import pytest
import trimesh
from gymnasium import spaces
from safetensors import safe_open

from benchmarks.leaderboard import Board
from benchmarks.nesting import cases
from packit_sim import (
    EvolutionSettings,
    PackItEnv,
    PackSettings,
    Part,
    Rules,
    dataset_file,
    pack,
)
from packit_sim.core.assets import assets_folder
from packit_sim.game.datasets import packs, provenance
from packit_sim.game.datasets.densification_settings import DensificationSettings
from packit_sim.game.datasets.manifests import Manifest, manifest_path
from packit_sim.game.envs.observations import OBSERVERS
from packit_sim.game.evaluation import transitions
from packit_sim.game.evaluation.judging import SCORES
from packit_sim.game.evaluation.learning_curves import CURVE_FILE, SETTINGS_FILE, CurvePoint
from packit_sim.geometry.quantized import QuantizedMesh
from packit_sim.libraries import stored
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.sources import ShapeInfo
from packit_sim.parts import export
from packit_sim.parts.packings import instances, packing_files
from packit_sim.parts.reading import manifest, named_containers
from packit_sim.parts.results import request
from packit_sim.physics.quality import QualityScores
from packit_sim.rules import End
from tests.doc_pages import DOCS, read, tables

FILES = DOCS / "reference" / "files.md"
INSTANCES = DOCS / "reference" / "instances.md"
ENVIRONMENT = DOCS / "reference" / "environment.md"

STORED: dict[str, tuple[type, dict[str, str]]] = {
    "Pack": (packs.Pack, {"format": "first", "version": "first"}),
    "LibraryRef": (packs.LibraryRef, {}),
    "PackedItem": (packs.PackedItem, {}),
    "PoseRecord": (packs.PoseRecord, {}),
    "ItemRecord": (packs.ItemRecord, {}),
    "Evolved": (provenance.Evolved, {"kind": "first"}),
    "Densified": (provenance.Densified, {"kind": "first"}),
    "Sampled": (provenance.Sampled, {"kind": "first"}),
    "Puzzle": (provenance.Puzzle, {"kind": "first"}),
    "Drawn": (provenance.Drawn, {"kind": "first"}),
    "FromOriginal": (provenance.FromOriginal, {"kind": "first"}),
    "Other": (provenance.Other, {"kind": "first"}),
    "Played": (provenance.Played, {"kind": "first"}),
    "EvolutionSettings": (EvolutionSettings, {}),
    "DensificationSettings": (DensificationSettings, {}),
    "Rules": (Rules, {}),
    "QualityScores": (QualityScores, {}),
    "Manifest": (Manifest, {}),
    "_Packing": (packing_files._Packing, {}),
    "_PackingItem": (packing_files._PackingItem, {}),
    "Request": (request.Request, {}),
    "RequestedPart": (request.RequestedPart, {}),
    "RequestedBox": (request.RequestedBox, {}),
    "_Entry": (named_containers._Entry, {}),
    "_Catalogue": (stored._Catalogue, {"format": "first"}),
    "ShapeInfo": (ShapeInfo, {}),
    "QuantizedMesh": (QuantizedMesh, {}),
    "CurvePoint": (CurvePoint, {}),
    "Board": (Board, {}),
    "TransitionsManifest": (transitions.TransitionsManifest, {}),
    "Shard": (transitions.Shard, {}),
    "Transitions": (transitions.Transitions, {}),
}
"""The type of each table of files.md, and the fields that the writer adds before its own."""


def names(rows: list[list[str]]) -> list[str]:
    return [re.fullmatch(r"`([\w -]+)`", row[0])[1] for row in rows]  # type: ignore[index]


def stored_names(kind: type) -> list[str]:
    """The names of a type's fields in files."""
    if dataclasses.is_dataclass(kind):
        return [field.name for field in dataclasses.fields(kind)]
    return [field.encode_name for field in msgspec.structs.fields(kind)]


@pytest.mark.parametrize("key", STORED)
def test_files_lists_the_fields_of(key) -> None:
    kind, added = STORED[key]
    assert names(tables(FILES)[key]) == [*added, *stored_names(kind)]


def test_instances_lists_the_fields_of_its_files() -> None:
    for key, rows in tables(INSTANCES).items():
        assert names(rows) == stored_names(getattr(instances, key))
    assert {"_Instance", "_Base", "_InstanceItem", "_Solution"} <= set(tables(INSTANCES))


@pytest.mark.parametrize("name", ["published", "two-task-strips"])
def test_instances_has_the_figures_of_the_tables(name) -> None:
    lines = Path(cases.__file__).with_name(f"{name}.csv").read_text().splitlines()[1:]
    shown = {re.sub(r"[`| ]", "", line) for line in read(INSTANCES).splitlines()}
    for line in lines:
        cells = line.split(",")
        if name == "published":
            file, steps, seeds, *heights = cells
            rotations = "fixed" if steps == "1" else f"axis-{steps}"
            heights = [height or "-" for height in heights]
            cells = [file.removesuffix(".json").replace(" ", ""), rotations, *heights, seeds]
        assert "".join(cells) in shown, line


def test_every_table_of_files_is_compared() -> None:
    others = {
        "NetworkSettings",
        "packing-of-parts",
        "parts",
        "values-of-columns",
        "weights",
        "weights-of-placements",
    }
    assert set(tables(FILES)) == {*STORED, *others}


def test_the_shipped_packs_have_the_fields_that_files_lists() -> None:
    rows = {row[0].strip("`"): row for row in tables(FILES)["Pack"]}
    for line in dataset_file("starter").read_text().splitlines():
        content = json.loads(line)
        assert content["format"] == packs.FORMAT
        assert set(content) <= set(rows)
        assert {n for n, row in rows.items() if "optional" not in row[2]} <= set(content)
    described = json.loads(manifest_path(dataset_file("starter")).read_text())
    assert set(described) <= set(names(tables(FILES)["Manifest"]))


def test_the_shipped_library_has_the_fields_that_files_lists() -> None:
    folder = assets_folder() / "everyday"
    content = json.loads((folder / "library.json").read_text())
    assert list(content) == names(tables(FILES)["_Catalogue"])
    assert list(content["shapes"][0]) == names(tables(FILES)["ShapeInfo"])
    assert list(json.loads((folder / "splits.json").read_text())) == [
        *re.findall(r"`(\w+)`", read(FILES).split("`splits.json` | the ids of each split: ")[1])[:4]
    ]
    with np.load(next((folder / "meshes").glob("*.npz"))) as arrays:
        assert sorted(arrays) == sorted(names(tables(FILES)["QuantizedMesh"]))


def test_files_says_what_the_scores_are() -> None:
    assert set(names(tables(FILES)["QualityScores"])) == set(SCORES)


def test_files_gives_the_version_of_each_format() -> None:
    shown = dict(re.findall(r"^\| \[(\w+)\]\(#\w+\).*\| (\w+) \|$", read(FILES), re.MULTILINE))
    assert shown["packs"] == shown["results"] == shown["manifest"] == str(packs.FORMAT)
    assert shown["library"] == str(stored.FORMAT)


def test_files_lists_the_metadata_of_weights() -> None:
    pytest.importorskip("torch")
    from packit_agents.learning import weights
    from packit_agents.learning.networks import NetworkSettings

    assert f"| [weights](#weights), `NAME.safetensors` | `packit train` | {weights.VERSION} |" in (
        read(FILES)
    )
    with safe_open(assets_folder() / "weights" / "packnn.safetensors", "numpy") as file:
        metadata = file.metadata()
    assert set(names(tables(FILES)["weights"])) == set(metadata)
    assert metadata["format"] == weights.FORMAT
    assert names(tables(FILES)["NetworkSettings"]) == stored_names(NetworkSettings)
    assert set(json.loads(metadata["network"])) == set(stored_names(NetworkSettings))


def test_files_lists_the_metadata_of_weights_of_placements() -> None:
    with safe_open(assets_folder() / "weights" / "champion.safetensors", "numpy") as file:
        metadata = file.metadata()
    assert set(names(tables(FILES)["weights-of-placements"])) == set(metadata)


def test_files_lists_the_metadata_of_values_of_columns() -> None:
    with safe_open(assets_folder() / "weights" / "blockout.safetensors", "numpy") as file:
        metadata = file.metadata()
    assert set(names(tables(FILES)["values-of-columns"])) == set(metadata)


def test_files_lists_the_fields_of_the_record_of_packed_parts(tmp_path) -> None:
    box = trimesh.creation.box((30, 20, 10))
    settings = PackSettings(workers=1, iterations=1, keep_out=(Part("pillar", pillar()),))
    packed = pack([Part("block", box)], (40, 40, 40), settings=settings)
    export(packed, tmp_path)
    record = json.loads((tmp_path / "packing.json").read_text())
    listed = tables(FILES)
    assert list(record) == names(listed["packing-of-parts"])
    assert set(record["items"][0]) <= {*names(listed["_PackingItem"]), "name"}
    assert set(record["obstacles"][0]) <= {*names(listed["_PackingItem"]), "name", "is part"}


def pillar() -> trimesh.Trimesh:
    return trimesh.creation.box((5, 5, 40)).apply_translation((37, 37, 20))


def test_files_lists_the_fields_of_lists_of_parts() -> None:
    assert names(tables(FILES)["parts"]) == list(manifest._FIELDS)


def test_files_lists_the_files_of_trainings() -> None:
    text = read(FILES)
    for name in (CURVE_FILE, SETTINGS_FILE):
        assert f"| `{name}` |" in text


def described(space: spaces.Space[Any]) -> str:
    """A space as the page writes it."""
    if isinstance(space, spaces.Discrete):
        return f"`Discrete({space.n})`"
    kind = "int8" if isinstance(space, spaces.MultiBinary) else str(space.dtype)
    return f"{kind} {tuple(int(n) for n in space.shape)}".replace(",)", ",)")


@pytest.mark.parametrize("observation", OBSERVERS)
def test_environment_lists_the_fields_of_observations(observation) -> None:
    env = gymnasium.make("PackIt-v0", observation=observation)
    listed = tables(ENVIRONMENT)
    rows = listed["none"] + ([] if observation == "none" else listed[observation])
    if observation == "placement-features":
        rows = listed["none"] + listed["features"] + listed[observation]
    shown = {row[0].strip("`"): row[1] for row in rows}
    space = env.observation_space
    assert isinstance(space, spaces.Dict)
    assert shown == {key: described(part) for key, part in space.items()}
    assert set(listed) == set(OBSERVERS)


def rows_under(heading: str) -> list[list[str]]:
    """The rows of the first table under a heading of the page."""
    part = re.split(r"^## ", read(ENVIRONMENT).split(f"\n## {heading}\n")[1], flags=re.MULTILINE)[0]
    lines = [line for line in part.splitlines() if line.startswith("|")][2:]
    return [[cell.strip() for cell in line[1:-1].split(" | ")] for line in lines]


def test_environment_lists_every_argument_with_its_default() -> None:
    signature = inspect.signature(PackItEnv).parameters
    defaults = {name: p.default for name, p in signature.items() if name != "changes"}
    defaults |= {field.name: field.default for field in dataclasses.fields(Rules)}
    shown = {row[0].strip("`"): row[1] for row in rows_under("Arguments")}
    assert set(shown) == set(defaults)
    for name, value in defaults.items():
        written = json.dumps(value) if isinstance(value, str) else repr(value)
        assert shown[name] == ("`PACKIT`" if name == "rules" else f"`{written}`"), name


def test_environment_lists_the_keys_of_info() -> None:
    env = gymnasium.make("PackIt-v0", observation="none")
    _, info = env.reset(seed=0)
    keys = [row[0].strip("`") for row in rows_under("Info")]
    assert keys == list(info)
    action = int(np.flatnonzero(info["action_mask"] == 0)[0])
    _, _, terminated, _, info = env.step(action)
    assert terminated and keys == list(info)


def test_environment_lists_every_end() -> None:
    assert [row[0].strip("`") for row in rows_under("Episode end")] == list(End)


def test_environment_names_every_id() -> None:
    ours = {
        name
        for name, spec in gymnasium.registry.items()
        if str(spec.entry_point).startswith("packit_sim")
    }
    assert set(re.findall(r"^\| `(PackIt\w*-v\d)` \|", read(ENVIRONMENT), re.MULTILINE)) == ours


def test_the_library_has_as_many_shapes_as_datasets_says() -> None:
    page = read(DOCS / "reference" / "datasets.md")
    library = ShapeLibrary.open("everyday")
    assert f"{len(library)} everyday objects in {len(library.categories)} categories" in page
    for split in ("train", "test", "validation"):
        assert f"| `{split}` | {len(library.split(split))} |" in page
