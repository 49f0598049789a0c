"""A library's digest covers whatever changes a result; former digests of the same content hold."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from packit_sim.core.assets import assets_folder
from packit_sim.core.errors import LibraryError
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.pack_files import dataset_file, read_packs, write_packs
from packit_sim.game.datasets.packs import LibraryRef
from packit_sim.libraries import stored
from packit_sim.libraries.library import ShapeLibrary
from tests.zoo import CUBE, RING

Content = dict[str, Any]


def halved(catalogue: Content, splits: Content) -> None:
    catalogue["shapes"][0]["volume"] /= 2


def renamed_category(catalogue: Content, splits: Content) -> None:
    catalogue["shapes"][0]["category"] = "else"


def moved(catalogue: Content, splits: Content) -> None:
    splits["test"], splits["train"] = splits["train"], splits["test"]


def edit(folder: Path, *changes: Callable[[Content, Content], object]) -> ShapeLibrary:
    files = folder / "library.json", folder / "splits.json"
    catalogue, splits = (json.loads(file.read_text()) for file in files)
    for change in changes:
        change(catalogue, splits)
    for file, content in zip(files, (catalogue, splits), strict=True):
        file.write_text(json.dumps(content))
    return ShapeLibrary.open(folder)


def with_former_digest(catalogue: Content, splits: Content) -> None:
    lines = "".join(f"{shape['id']} {shape['digest']}\n" for shape in catalogue["shapes"])
    catalogue["digest"] = hashlib.sha256(lines.encode()).hexdigest()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    stored.write(tmp_path / "lib", "lib", "1", map(stored.entry, (CUBE, RING)))
    return tmp_path / "lib"


@pytest.mark.parametrize("change", [halved, renamed_category, moved])
def test_a_library_with_other_content_does_not_open(folder: Path, change: Any) -> None:
    ShapeLibrary.open(folder)
    with pytest.raises(LibraryError, match="damaged: its shapes don't match its digest"):
        edit(folder, change)


@pytest.mark.parametrize("change", [halved, renamed_category, moved])
def test_the_content_of_the_builtin_library_is_known(tmp_path: Path, change: Any) -> None:
    shutil.copytree(assets_folder() / "everyday", tmp_path / "everyday")
    assert edit(tmp_path / "everyday").digest == ShapeLibrary.open("everyday").digest
    with pytest.raises(LibraryError, match="damaged: its shapes don't match its digest"):
        edit(tmp_path / "everyday", change)


def test_libraries_of_former_versions_open_and_their_volumes_are_measured(folder: Path) -> None:
    new = ShapeLibrary.open(folder).digest
    library = edit(folder, with_former_digest)
    assert library.digest != new and len(library) == 2


@pytest.mark.slow
def test_a_false_volume_does_not_verify(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pack = read_packs(dataset_file("starter"))[0]
    shutil.copytree(assets_folder() / "everyday", tmp_path / "lib")
    monkeypatch.setattr(stored, "FORMER_DIGESTS", {})  # as for a library that is not built in

    def larger(catalogue: Content, splits: Content) -> None:
        for shape in catalogue["shapes"]:
            shape["volume"] = min(1.0, shape["volume"] * 3)

    library = edit(tmp_path / "lib", larger)
    assert library.digest == pack.library.digest
    write_packs(tmp_path / "packs.jsonl", [pack])
    problems = [str(p) for p in verify_dataset(tmp_path / "packs.jsonl", library).problems]
    assert any("the library records volume" in problem for problem in problems)
    assert LibraryRef.of(library) == pack.library
