"""ShapeNetCore's two layouts, on small generated trees."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from trimesh import creation

from packit_sim.core.errors import LibraryError, UnknownShapeError
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.shapenet import CATEGORIES

MUG, CHAIR, KITE = "03797390", "03001627", "09999999"


def add(tree: Path, synset: str, model: str, file: str, height: float = 2.0) -> None:
    """A block that is so high along y, which is up in ShapeNet."""
    path = tree / synset / file.format(model)
    path.parent.mkdir(parents=True, exist_ok=True)
    creation.box((1, height, 0.5)).export(path)


@pytest.fixture(params=["v1", "v2", "glb"])
def tree(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    file = {
        "v1": "{}/model.obj",
        "v2": "{}/models/model_normalized.obj",
        "glb": "{}.glb",
    }[request.param]
    for n in range(7):
        add(tmp_path, MUG, f"mug{n}", file, 1 + 0.1 * n)
    for n in range(3):
        add(tmp_path, CHAIR, f"chair{n}", file)
    add(tmp_path, KITE, "box", file)
    synsets = [
        {"synsetId": MUG, "name": "mug", "children": [], "numInstances": 7},
        {"synsetId": KITE, "name": "box kite,kite", "children": [], "numInstances": 1},
    ]
    (tmp_path / "taxonomy.json").write_text(json.dumps(synsets))
    (tmp_path / "README.txt").write_text("not a synset")
    return tmp_path


def test_layouts_are_read_alike(tree: Path) -> None:
    library = ShapeLibrary.open(f"shapenet:{tree}")
    assert {name: len(ids) for name, ids in library.categories.items()} == {
        "box-kite": 1,
        "chair": 3,
        "mug": 7,
    }
    assert library.name == "shapenet" and "mug/mug3" in library
    shape = library["chair/chair1"]
    assert shape.extents == pytest.approx(np.array((1, 0.5, 2)) / 5.25**0.5)  # y up turned z up
    info = library.info("chair/chair1")
    assert info.solid and info.size_cm is None and str(tree) in info.source
    copy = pickle.loads(pickle.dumps(library))
    assert (copy.ids, copy.digest) == (library.ids, library.digest)


def test_the_papers_subsets(tree: Path) -> None:
    library = ShapeLibrary.open(f"shapenet:{tree}", seed=5)
    parts = [library.split(name) for name in ("train", "test", "validation")]
    assert sorted(id for part in parts for id in part) == list(library)
    assert sorted(len(part.categories["mug"]) for part in parts) == [2, 2, 3]
    assert [len(part.categories["chair"]) for part in parts] == [1, 1, 1]
    again = ShapeLibrary.open(f"shapenet:{tree}", seed=5).split("test")
    assert again.ids == parts[1].ids
    assert pickle.loads(pickle.dumps(parts[1])).ids == parts[1].ids
    seeds = {ShapeLibrary.open(f"shapenet:{tree}", seed=s).split("test").ids for s in range(6)}
    assert len(seeds) > 1


def test_a_category_of_many_gives_a_hundred_to_each_split(tmp_path: Path) -> None:
    for n in range(310):
        folder = tmp_path / MUG / f"{n:03}"
        folder.mkdir(parents=True)
        (folder / "model.obj").write_text("never read")
    library = ShapeLibrary.open(f"shapenet:{tmp_path}")
    assert [len(library.split(name)) for name in ("train", "test", "validation")] == [100] * 3


def test_a_model_in_two_synsets_is_one_object(tmp_path: Path) -> None:
    phones = ("02992529", "04401088")  # cellphone, telephone
    for n in range(12):
        for synset in phones:
            add(tmp_path, synset, f"m{n}", "{}/model.obj")
    library = ShapeLibrary.open(f"shapenet:{tmp_path}")
    models = [
        {id.rpartition("/")[2] for id in library.split(name)}
        for name in ("train", "test", "validation")
    ]
    assert sum(map(len, models)) == len(set.union(*models)) == 12


def test_models_without_a_mesh_are_reported(tree: Path) -> None:
    (tree / MUG / "hollow" / "models").mkdir(parents=True)
    library = ShapeLibrary.open(f"shapenet:{tree}")
    assert "mug/hollow" not in library and list(library.missing) == ["mug/hollow"]
    with pytest.raises(UnknownShapeError, match=r"hollow: holds none of models/model_normalized"):
        library["mug/hollow"]


def test_what_is_no_shapenet_is_refused(tree: Path, tmp_path: Path) -> None:
    (tree / "taxonomy.json").write_text('{"not": "a list"}')
    with pytest.raises(LibraryError, match=r"taxonomy\.json: can't be read.*got object"):
        ShapeLibrary.open(f"shapenet:{tree}")
    (tmp_path / "empty" / MUG).mkdir(parents=True)
    with pytest.raises(LibraryError, match=r"it holds 1 synset\s+folders"):
        ShapeLibrary.open(f"shapenet:{tmp_path / 'empty'}")
    with pytest.raises(LibraryError, match="'shapenet:/nowhere'"):
        ShapeLibrary.open("shapenet:/nowhere")


def test_all_of_shapenets_categories_have_a_name() -> None:
    assert len(CATEGORIES) == 57 and len(set(CATEGORIES.values())) == 57
