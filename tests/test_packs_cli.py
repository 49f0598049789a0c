"""`packit datasets` as a user runs it: statistics, files and errors."""

import json
import re
import shlex
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from PIL import Image
from trimesh import creation
from typer.testing import CliRunner, Result

from packit_sim.cli.app import app
from packit_sim.core.errors import PackFormatError, PackItError
from packit_sim.core.extras import MissingPackageError
from packit_sim.game.datasets import datasheet
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.original import read_original
from packit_sim.game.datasets.pack_files import dataset_files, load_tasks, read_packs, write_packs
from packit_sim.game.datasets.packs import LibraryRef, Pack, PackedItem
from packit_sim.game.datasets.provenance import UNKNOWN_PROVENANCE, Evolved, Other, Provenance
from packit_sim.game.datasets.statistics import DatasetStatistics, take
from packit_sim.game.generation.jobs import GenerationJob, generate
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.render.plots import COLORS
from tests.test_original import CHAIR, GOOD, MUG, pack, write

CUBE = 3**-1.5
"""Volumes of canonical shapes: their diagonal is 1."""
BRICK = 6 * 14**-1.5

SMALL = EvolutionSettings(pool=8, population=52, generations=2, size_range=(0.6, 0.8))


def packit(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in ("datasets", *arguments)])


def refusal(*arguments: str | Path) -> str:
    """The message of the one error that a command ends in."""
    error = packit(*arguments).exception
    assert isinstance(error, PackItError | OSError), error
    assert "\n" not in str(error)
    return str(error)


def colours(path: Path) -> set[int]:
    """Those of a picture, as 0xRRGGBB; it must be one that a page can show."""
    with Image.open(path) as picture:
        assert picture.width >= 1000 and picture.height >= 900
        return set(np.unique(np.asarray(picture) @ (1 << 16, 1 << 8, 1)).tolist())


TRAIN, TEST, VALIDATION = (int(colour[1:], 16) for colour in COLORS[:3])


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> ShapeLibrary:
    folder = tmp_path_factory.mktemp("library") / "blocks"
    for name, extents in (("toy/cube", (1, 1, 1)), ("toy/dice", (1, 1, 1)), ("brick", (1, 2, 3))):
        path = folder / f"{name}.stl"
        path.parent.mkdir(parents=True, exist_ok=True)
        creation.box(extents).export(path)
    return ShapeLibrary.open(f"folder:{folder}")


def pack_of(
    library: ShapeLibrary,
    *items: tuple[str, float, int],
    provenance: Provenance = UNKNOWN_PROVENANCE,
) -> Pack:
    """A pack of items (shape, scale, rotation), all of them somewhere."""
    placed = tuple(PackedItem(*item, (0, 0, 0)) for item in items)
    density = sum(library[shape].volume * scale for shape, scale, _ in items)
    return Pack(LibraryRef.of(library), (100, 100, 100), placed, density, provenance)


@pytest.fixture(scope="module")
def counted(blocks: ShapeLibrary, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of two splits whose numbers are known by hand."""
    folder = tmp_path_factory.mktemp("counted")
    train = [
        pack_of(
            blocks,
            ("toy/cube", 0.125, 0),
            ("brick", 0.25, 5),
            ("toy/cube", 0.03125, 23),
            provenance=Evolved(seed=0, generation=4, size=0.5, settings=SMALL),
        ),
        pack_of(
            blocks,
            ("toy/cube", 0.216, 1),
            provenance=Evolved(seed=1, generation=10, size=0.6, settings=SMALL),
        ),
        pack_of(blocks, ("brick", 1.0, 0), ("toy/dice", 1.0, 3), provenance=Other(author="hand")),
    ]
    write_packs(folder / "train.jsonl", train)
    write_packs(folder / "test.jsonl", [pack_of(blocks, ("brick", 0.5, 7))])
    return folder


@pytest.fixture(scope="module")
def evolved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of the built-in library's test and train split."""
    folder = tmp_path_factory.mktemp("evolved") / "small"
    for split, seed in (("train", 7), ("test", 3)):
        library = ShapeLibrary.open("everyday").split(split)
        generate(GenerationJob(library, 2, seed, split, settings=SMALL), folder / f"{split}.jsonl")
    return folder


def test_statistics_by_hand(blocks: ShapeLibrary, counted: Path) -> None:
    train, test = take(counted, blocks)
    assert (train.split, test.split) == ("train", "test")
    assert (train.packs, test.packs) == (3, 1)
    spreads = train.spreads()
    assert list(spreads) == ["items a pack", "density", "generation", "size factor"]
    items = spreads["items a pack"]
    assert (items.mean.mean, items.median, items.minimum, items.maximum) == (2, 2, 1, 3)
    assert items.mean.low is not None and 1 <= items.mean.low < 2 < items.mean.high <= 3
    densities = [CUBE * 0.15625 + BRICK * 0.25, CUBE * 0.216, CUBE + BRICK]
    assert spreads["density"].mean.mean == pytest.approx(np.mean(densities))
    assert spreads["density"].median == pytest.approx(np.median(densities))
    assert spreads["generation"].median == 7 and spreads["size factor"].median == 0.55
    volumes = [CUBE * 0.03125, CUBE * 0.125, BRICK * 0.25, CUBE * 0.216, BRICK, CUBE]
    assert sorted(train.volumes) == pytest.approx(sorted(volumes))
    quantiles = train.volume_quantiles()
    assert quantiles["median"] == pytest.approx((BRICK * 0.25 + CUBE * 0.216) / 2)
    assert quantiles["least"] == pytest.approx(CUBE * 0.03125)
    assert quantiles["most"] == pytest.approx(CUBE)
    assert train.scales == {1.0: 4, 2.0: 1, 0.25: 1}
    assert list(train.shapes.items()) == [("toy/cube", 3), ("brick", 2), ("toy/dice", 1)]
    assert list(train.categories.items()) == [("toy", 4), (blocks.source.categories["brick"], 2)]
    assert train.rotations.tolist() == [2, 1, 0, 1, 0, 1, *[0] * 17, 1]
    rows = train.rows()
    assert rows["items upright"] == "67%" and rows["rotations in use"] == "5 of 24"
    assert rows["items of scale 2"] == "17%" and rows["categories"] == "2"
    alone = test.spreads()
    assert alone["density"].mean.low is None and list(alone) == ["items a pack", "density"]


def test_a_box_of_another_size_counts_by_its_own_volume(blocks: ShapeLibrary) -> None:
    pack = Pack(
        LibraryRef.of(blocks), (200, 100, 100), (PackedItem("brick", 1.0, 0, (0, 0, 0)),), 0.5
    )
    statistics = DatasetStatistics.of("packs", [pack], blocks)
    assert statistics.volumes.tolist() == pytest.approx([BRICK / 2])


def test_scales_that_are_all_different_are_summarised(blocks: ShapeLibrary) -> None:
    items = [("brick", 0.1 + 0.01 * n, 0) for n in range(20)]
    rows = DatasetStatistics.of("packs", [pack_of(blocks, *items)], blocks).rows()
    assert rows["scales"] == "20: 0.1 to 0.29"
    assert not any(name.startswith("items of scale") for name in rows)


def test_splits_are_next_to_each_other(counted: Path, blocks: ShapeLibrary) -> None:
    library = f"folder:{blocks.path}"
    shown = packit("stats", counted, "--library", library)
    assert shown.exit_code == 0, shown.output
    lines = {line.strip().partition("  ")[0]: line.split() for line in shown.stdout.splitlines()}
    assert shown.stdout.split()[:2] == ["train", "test"]
    assert lines["packs"] == ["packs", "3", "1"] and lines["items"] == ["items", "6", "1"]
    assert "1.0 to 3.0" in shown.stdout and "4 to 10" in shown.stdout
    alone = packit("stats", counted, "--split", "test", "--library", library)
    assert "train" not in alone.stdout and "packs" in alone.stdout


def test_counts_are_written_as_json_and_drawn(
    counted: Path, blocks: ShapeLibrary, tmp_path: Path
) -> None:
    out, counts = tmp_path / "new" / "stats.png", tmp_path / "stats.json"
    library = ("--library", f"folder:{blocks.path}")
    done = packit("stats", counted, *library, "--out", out, "--json", counts)
    assert done.exit_code == 0 and f"wrote {out}" in done.stdout, done.output
    counted_items = json.loads(counts.read_text())
    assert list(counted_items) == ["train", "test"]
    assert counted_items["train"]["items a pack"]["median"] == 2
    assert counted_items["train"]["items by scale"] == {"0.25": 1, "1": 4, "2": 1}
    assert sum(counted_items["train"]["items by rotation"]) == 6
    drawn = colours(out)
    assert {TRAIN, TEST, 0xFFFFFF} < drawn and VALIDATION not in drawn
    before = out.read_bytes()
    packit("stats", counted, *library, "--out", out)
    assert out.read_bytes() == before


def test_a_split_keeps_its_colour(counted: Path, blocks: ShapeLibrary, tmp_path: Path) -> None:
    out = tmp_path / "test.png"
    arguments = ("--split", "test", "--library", f"folder:{blocks.path}", "--out", out)
    assert packit("stats", counted, *arguments).exit_code == 0
    drawn = colours(out)
    assert TEST in drawn and TRAIN not in drawn


def test_the_files_of_a_dataset_are_in_the_order_of_splits(tmp_path: Path) -> None:
    for name in ("aside", "validation", "train"):
        (tmp_path / f"{name}.jsonl").touch()
    assert [file.stem for file in dataset_files(tmp_path)] == ["train", "validation", "aside"]
    assert dataset_files("starter")[0].name == "packs.jsonl"


@pytest.mark.slow
def test_a_page_says_how_to_regenerate_a_dataset(evolved: Path, tmp_path: Path) -> None:
    out = tmp_path / "small.md"
    done = packit("datasheet", evolved, "--licence", "CC0-1.0", "--out", out)
    assert done.exit_code == 0, done.output
    page = out.read_text()
    assert page.startswith("# small\n\n4 packs (2 train, 2 test) of shapes of the library")
    for text in (
        "Licence of the packs: CC0-1.0.",
        "CC-BY-3.0",
        "| `train.jsonl` | 2 | 7 to 8 | `",
        "| generations | 2 | 2 |",
        "not those of ShapeNet",
        "bottom-left-back-fill",
        "at most 2 generations; the paper uses 1000",
        "0.6 to 0.8",
        "may be unstable",
        "No object is in two splits",
        f"digest `{ShapeLibrary.open('everyday').digest}`",
        "![Histograms of small](small.png)",
    ):
        assert text in " ".join(page.split()), text
    assert (tmp_path / "small.png").exists() and max(map(len, prose(page))) <= datasheet.WIDTH
    train, test = re.findall(r"^\$ packit (generate .*--split \w+ .*)$", page, re.MULTILINE)
    assert "--split train" in train
    words = [*shlex.split(test), "--workers", "1"]
    words[words.index("--out") + 1] = str(tmp_path / "again")
    again = CliRunner().invoke(app, words)
    assert again.exit_code == 0, again.output
    regenerated = (tmp_path / "again" / "test.jsonl").read_bytes()
    assert regenerated == (evolved / "test.jsonl").read_bytes()
    packit("datasheet", evolved, "--licence", "CC0-1.0", "--out", out)
    assert out.read_text() == page


def prose(page: str) -> list[str]:
    """The lines that are neither of a table nor a command."""
    return [line for line in page.splitlines() if not line.startswith(("|", "$", "`"))]


def test_a_page_of_one_split_and_of_minimal_packs(
    evolved: Path, counted: Path, blocks: ShapeLibrary, tmp_path: Path
) -> None:
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "test.jsonl").write_bytes((evolved / "test.jsonl").read_bytes())
    packit("datasheet", tmp_path / "half", "--out", tmp_path / "half.md")
    page = (tmp_path / "half.md").read_text()
    assert "2 packs (2 test)" in page and "No object" not in page
    assert "of unknown version" in page  # no manifest
    library = ("--library", f"folder:{blocks.path}")
    done = packit("datasheet", counted, *library, "--out", tmp_path / "counted.md")
    assert done.exit_code == 0, done.output
    page = " ".join((tmp_path / "counted.md").read_text().split())
    assert "No single command generates train again" in page and "unknown" in page
    assert "if the shapes are similar" in page and "those of ShapeNet" not in page
    assert "1 object occurs in more than one split" in page  # the brick


def test_what_has_no_command_says_so(evolved: Path) -> None:
    library = ShapeLibrary.open("everyday")
    part = datasheet.read(evolved, library)[0]
    command = part.command("everyday", "x")
    assert command == (
        "packit generate --packs 2 --seed 7 --split train --pool 8 --population 52 "
        "--generations 2 --size-range 0.6 0.8 --out x"
    )
    one = replace(part, packs=part.packs[1:])
    assert "--packs 1 --seed 8" in (one.command("everyday", "x") or "")
    assert "--library 'shapenet:a b'" in (one.command("shapenet:a b", "x") or "")
    first, second = (pack.provenance for pack in part.packs)
    elite = replace(first.settings, elite=3)
    for other in (
        structs.replace(second, seed=9),
        Other(author="hand"),
        structs.replace(second, settings=elite),
    ):
        changed = [part.packs[0], replace(part.packs[1], provenance=other)]
        assert replace(part, packs=changed).command("everyday", "x") is None
    kept = [replace(p, provenance=structs.replace(p.provenance, after=2)) for p in part.packs]
    assert "--history --out" in (replace(part, packs=kept).command("everyday", "x") or "")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["stats", "nowhere"], "packs can't be read from nowhere: No such file"),
        (["stats", "{empty}"], "is a folder without packs: it has no .jsonl file"),
        (
            ["stats", "{empty}", "--split", "test"],
            "is a folder without packs: it has no .jsonl file",
        ),
        (["stats", "starter", "--split", "test"], "there is no 'test'"),
        (["stats", "starter", "--library", "{library}"], "the pack is of library"),
        (["stats", "starter", "--library", "none"], "no shape library 'none'"),
        (["stats", "{bare}"], "the packs of 'bare' hold no items"),
        (["stats", "starter", "--out", "{file}/x.png"], "file"),
        (["stats", "starter", "--json", "{file}/x.json"], "file"),
        (["stats", "starter", "--out", "{empty}"], "empty"),
        (["datasheet", "nowhere", "--out", "{empty}/x.md"], "packs can't be read from nowhere"),
        (["datasheet", "starter", "--out", "{file}/x.md"], "file"),
        (["datasheet", "starter", "--out", "{empty}/x.png"], "a name that ends in .md"),
    ],
)
def test_bad_input_is_refused_and_writes_nothing(
    arguments: list[str], message: str, blocks: ShapeLibrary, tmp_path: Path
) -> None:
    places = {
        "empty": tmp_path / "empty",
        "file": tmp_path / "file",
        "bare": tmp_path / "bare.jsonl",
    }
    places["empty"].mkdir()
    places["file"].write_text("in the way")
    empty = Pack(LibraryRef.of(ShapeLibrary.open("everyday")), (100, 100, 100), (), 0.0)
    write_packs(places["bare"], [empty])
    before = sorted(tmp_path.rglob("*"))
    filled = [a.format(**places, library=f"folder:{blocks.path}") for a in arguments]
    assert message in refusal(*filled)
    assert sorted(tmp_path.rglob("*")) == before


def test_without_matplotlib_it_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for command in (("stats", "starter"), ("datasheet", "starter")):
        error = packit(*command, "--out", tmp_path / "x.md").exception
        assert isinstance(error, MissingPackageError) and "packit-sim[report]" in str(error)
    assert not list(tmp_path.iterdir())
    assert packit("stats", "starter").exit_code == 0


@pytest.fixture(scope="module")
def shapenet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    tree = tmp_path_factory.mktemp("shapenet")
    for model, extents in (
        (f"{MUG}/mug0", (1, 1, 0.5)),
        (f"{MUG}/mug2", (1, 1.4, 0.5)),
        (f"{CHAIR}/chair", (0.7, 1.1, 0.5)),
    ):
        (tree / model).mkdir(parents=True)
        creation.box(extents).export(tree / model / "model.obj")
    return tree


@pytest.fixture
def original(shapenet: Path, tmp_path: Path) -> Callable[..., Result]:
    """Runs `packs original` on two files with a pack that has all shapes, and one that has not."""
    lame = pack(f"{MUG}/mug0", f"{CHAIR}/throne")
    files = [write(tmp_path / "0_te", GOOD, lame), write(tmp_path / "1_te", GOOD)]

    def run(*arguments: str | Path) -> Result:
        out = ("--out", tmp_path / "tasks.jsonl")
        return packit("original", *files, "--library", f"shapenet:{shapenet}", *out, *arguments)

    return run


@pytest.mark.slow
def test_packs_of_the_original_become_tasks_that_agents_play(
    original: Callable[..., Result], shapenet: Path, tmp_path: Path
) -> None:
    done = original("--report", tmp_path / "report.json")
    assert done.exit_code == 0, done.output
    assert "3 packs: 2 whole, 1 left out; 1 item without a shape" in done.stdout
    assert "throne" in done.stdout and "2 tasks" in done.stdout
    (problem,) = json.loads((tmp_path / "report.json").read_text())["unresolved"]
    assert problem["source"] == f"Shapes_te/{CHAIR}/throne/model.obj"
    assert (problem["file"], problem["pack"], problem["item"]) == ("0_te", "1", "1")

    library = ShapeLibrary.open(f"shapenet:{shapenet}")
    loaded = load_tasks(tmp_path / "tasks.jsonl", library)
    read = read_original(tmp_path / "0_te", library).tasks
    assert loaded[:1] == read and loaded[0].solution == () == loaded[0].pack.items
    assert [item.shape.id for item in loaded[0].items] == ["chair/chair", "mug/mug0", "mug/mug2"]
    played = CliRunner().invoke(
        app,
        [
            *("evaluate", str(tmp_path / "tasks.jsonl"), "--library", f"shapenet:{shapenet}"),
            *("--agent", "largest-first/aligned/blbf"),
        ],
    )
    assert played.exit_code == 0, played.output
    assert "largest-first" in played.stdout


def test_packs_of_the_original_may_be_kept_in_part(
    original: Callable[..., Result], tmp_path: Path
) -> None:
    assert original("--partial").exit_code == 0
    sizes = [len(pack.outside) for pack in read_packs(tmp_path / "tasks.jsonl")]
    assert sizes == [3, 1, 3]


def test_packs_of_the_original_without_any_task_are_refused(shapenet: Path, tmp_path: Path) -> None:
    file = write(tmp_path / "0_te", pack(f"{CHAIR}/throne"))
    out = tmp_path / "tasks.jsonl"
    library = ("--library", f"shapenet:{shapenet}", "--out", out)
    assert "none of the 1 packs" in refusal("original", file, *library)
    assert "No such file" in refusal("original", tmp_path / "absent", *library)
    (tmp_path / "bad").write_text("{")
    assert "is not JSON" in refusal("original", tmp_path / "bad", *library)
    assert "no shape library" in refusal("original", file, "--library", "shapenet:x", "--out", out)
    assert not out.exists()


def test_a_pack_may_leave_items_of_its_task_outside(blocks: ShapeLibrary) -> None:
    whole = pack_of(blocks, ("brick", 0.5, 7))
    line = whole.to_json()
    assert '"outside"' not in line and Pack.from_json(line) == whole
    raw = json.loads(line)
    raw["outside"] = [{"shape": "toy/cube", "scale": 0.25}, {"shape": "brick", "scale": 0.125}]
    part = Pack.from_json(json.dumps(raw))
    assert Pack.from_json(part.to_json()) == part
    task = part.task(blocks)
    assert [(item.shape.id, item.scale) for item in task.items] == [
        ("brick", 0.125),
        ("brick", 0.5),
        ("toy/cube", 0.25),
    ]
    assert task.solution == ((1, 7, (0, 0, 0)),)
    for field, value, message in (
        ("outside", {}, "'outside' is {}: expected array"),
        (
            "outside",
            [{"shape": "brick", "scale": 0}],
            r"'outside\[0\].scale' is 0: expected float > 0",
        ),
        ("outside", [{"scale": 1}], r"'outside\[0\].shape' is missing"),
    ):
        with pytest.raises(PackFormatError, match=message):
            Pack.from_json(json.dumps({**raw, field: value}))
