"""`packit shapes` as a user runs it; `import` is in test_importer."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from trimesh import creation

from packit_sim.core.choices import SPLITS
from packit_sim.libraries.library import ShapeLibrary
from tests import bad_meshes
from tests.runs import run_packit as packit


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("meshes")
    (folder / "round").mkdir()
    creation.icosphere(subdivisions=2).export(folder / "round" / "ball.stl")
    creation.cone(1, 2).export(folder / "round" / "cone.stl")
    creation.box((1, 2, 3)).export(folder / "brick.obj")
    return folder


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture)


def test_shapes_are_listed_by_category_and_split(meshes: Path) -> None:
    everyday = ShapeLibrary.open("everyday")
    mugs = packit("shapes", "list", "--category", "mug")
    assert mugs.returncode == 0, mugs.stderr
    assert f"{len(everyday.categories['mug'])} shapes" in mugs.stdout
    assert "watertight" in mugs.stdout and "CC-BY" in mugs.stdout
    train = packit("shapes", "list", "--split", "train", "--category", "mug")
    assert all(id in train.stdout for id in everyday.split("train").categories["mug"])
    assert f"{len(everyday.split('train').categories['mug'])} shapes" in train.stdout
    folder = packit("shapes", "list", "--library", f"folder:{meshes}")
    assert "round/cone" in folder.stdout and "watertight" not in folder.stdout


def test_a_shape_is_shown_with_all_that_is_known(meshes: Path, tmp_path: Path) -> None:
    everyday = ShapeLibrary.open("everyday")
    id = everyday.ids[100]
    info = everyday.info(id)
    shown = packit("shapes", "show", id, "--out", tmp_path / "it.png", "--size", "200")
    assert shown.returncode == 0, shown.stderr
    flat = " ".join(shown.stdout.split())
    split = next(name for name in SPLITS if id in everyday.split(name))
    for text in (info.category, info.licence, info.digest[:40], f"split {split}", "same object"):
        assert text in flat
    assert pixels(tmp_path / "it.png").shape[1] >= 200
    mine = packit("shapes", "show", "round/ball", "--library", f"folder:{meshes}")
    assert mine.returncode == 0 and "solid yes" in " ".join(mine.stdout.split())


def test_statistics_add_up(meshes: Path) -> None:
    everyday = ShapeLibrary.open("everyday")
    counted = packit("shapes", "stats")
    assert counted.returncode == 0, counted.stderr
    lines = [line.split() for line in counted.stdout.splitlines() if line.strip()]
    rows = {name: cells for name, *cells in lines}
    assert set(everyday.categories) < set(rows)
    sizes = [len(everyday), *(len(everyday.split(name)) for name in SPLITS)]
    assert rows["all"][:4] == [str(size) for size in sizes]
    summed = np.sum([[int(n) for n in rows[name][:5]] for name in everyday.categories], axis=0)
    assert summed.tolist() == [int(n) for n in rows["all"][:5]]
    assert f"{len(everyday)} shapes in {len(everyday.categories)} categories" in counted.stdout
    assert "CC0-1.0: " in counted.stdout
    assert "3" in packit("shapes", "stats", "--library", f"folder:{meshes}").stdout


@pytest.mark.slow
def test_a_contact_sheet_shows_a_selection(meshes: Path, tmp_path: Path) -> None:
    out = tmp_path / "sheet.png"
    drawn = packit(
        "shapes", "contact-sheet", "--library", f"folder:{meshes}", "--size", "64", "--out", out
    )
    assert drawn.returncode == 0 and "3 shapes" in drawn.stdout, drawn.stderr
    height, width, _ = pixels(out).shape
    assert 128 < width < 200 and height > width  # two columns, with labels below
    one = packit(
        *("shapes", "contact-sheet", "--per-category", "1", "--columns", "2", "--size", "64"),
        *("--library", f"folder:{meshes}", "--out", out),
    )
    assert "2 shapes" in one.stdout and pixels(out).shape[0] < height


def test_a_contact_sheet_says_what_can_not_be_read(meshes: Path, tmp_path: Path) -> None:
    for name in ("nan.stl", "many.ply"):
        bad_meshes.write(tmp_path, [name])
    creation.box().export(tmp_path / "good.stl")
    drawn = packit(
        *("shapes", "contact-sheet", "--library", f"folder:{tmp_path}", "--size", "64"),
        *("--out", tmp_path / "sheet.png"),
    )
    assert drawn.returncode == 1 and (tmp_path / "sheet.png").exists()
    assert "nan.stl" in drawn.stdout and "10,000,000 elements" in drawn.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["list", "--category", "mugs"], "no category 'mugs': choose from"),
        (["list", "--split", "dev"], "'dev' is not one of 'train', 'test', 'validation'"),
        (["show", "teapott"], "did you mean"),
        (["contact-sheet", "--id", "nobody", "--out", "x.png"], "no shape 'nobody'"),
        (["contact-sheet", "--size", "5", "--out", "x.png"], "'--size'"),
        (["stats", "--library", "shapenet:nowhere"], "'shapenet:nowhere'"),
    ],
)
def test_errors_name_the_value_and_the_choices(
    arguments: list[str], message: str, tmp_path: Path
) -> None:
    done = packit("shapes", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert message in " ".join(done.stderr.replace("│", " ").split()), done.stderr
    assert not list(tmp_path.iterdir())
