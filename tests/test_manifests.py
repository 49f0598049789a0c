"""Manifests: their names, former names, foreign files of the same name, and symbolic links."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from packit_sim.core.errors import BusyError, PackFormatError
from packit_sim.core.files import claimed, lock_path
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.manifests import Manifest, find_manifest, manifest_path
from packit_sim.game.datasets.pack_files import dataset_file, read_packs, write_packs
from packit_sim.game.evaluation.results_store import opened
from packit_sim.libraries.library import ShapeLibrary

PACKS = read_packs(dataset_file("starter"))


def former(path: Path) -> Path:
    """Give the manifest of a file the name that it had in former versions."""
    return manifest_path(path).rename(path.with_suffix(".manifest.json"))


def test_files_of_one_stem_have_separate_manifests(tmp_path: Path) -> None:
    for n, name in enumerate(["res.a", "res.b", "lr0.1", "lr0.2"]):
        write_packs(tmp_path / name, PACKS[n : n + 1])
    for n, name in enumerate(["res.a", "res.b", "lr0.1", "lr0.2"]):
        assert read_packs(tmp_path / name) == PACKS[n : n + 1]
    assert manifest_path(tmp_path / "lr0.1").name == "lr0.1.manifest.json"


def test_a_foreign_manifest_is_never_overwritten(tmp_path: Path) -> None:
    for name in ("notes.manifest.json", "notes.txt.manifest.json"):
        (tmp_path / name).write_text('{"name": "an app"}')
    with pytest.raises(
        PackFormatError, match=r"notes.txt.manifest.json is not a manifest of packs"
    ):
        write_packs(tmp_path / "notes.txt", PACKS[:1])
    assert not (tmp_path / "notes.txt").exists()
    with pytest.raises(PackFormatError, match="is not overwritten"), opened(tmp_path / "notes.txt"):
        pass
    (tmp_path / "notes.txt.manifest.json").unlink()
    write_packs(tmp_path / "notes.txt", PACKS[:1])
    assert read_packs(tmp_path / "notes.txt") == PACKS[:1]
    assert (tmp_path / "notes.manifest.json").read_text() == '{"name": "an app"}'


@pytest.mark.slow
def test_manifests_of_former_names_are_read_and_replaced(tmp_path: Path) -> None:
    file = tmp_path / "res.jsonl"
    write_packs(file, PACKS[:2])
    old = former(file)
    assert find_manifest(file, file.read_bytes()) == old and read_packs(file) == PACKS[:2]
    assert verify_dataset(tmp_path / "res.jsonl", ShapeLibrary.open("everyday")).is_valid
    write_packs(file, PACKS[:3])
    assert not old.exists() and Manifest.read(manifest_path(file)).packs == 3
    former(file)
    file.write_bytes(file.read_bytes() * 2)
    with pytest.raises(PackFormatError, match=r"not the file that res.manifest.json describes"):
        read_packs(file)


def test_a_former_manifest_of_another_file_does_not_count(tmp_path: Path) -> None:
    for n, name in enumerate(["res.a", "res.b"]):
        write_packs(tmp_path / name, PACKS[n : n + 1])
        former(tmp_path / name)
    assert read_packs(tmp_path / "res.a") == PACKS[:1]
    write_packs(tmp_path / "res.a", PACKS[2:3])
    assert read_packs(tmp_path / "res.b") == PACKS[1:2]


def test_a_symbolic_link_stays_and_its_target_is_written(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    real, link = tmp_path / "disk" / "data.jsonl", tmp_path / "res.jsonl"
    write_packs(real, PACKS[:1])
    link.symlink_to(real)
    write_packs(link, PACKS[:2])
    assert link.is_symlink() and read_packs(real) == read_packs(link) == PACKS[:2]
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["res.jsonl"]
    with claimed(lock_path(link), link), pytest.raises(BusyError), opened(real):
        pass


def test_links_to_content_under_other_names_keep_their_manifests(tmp_path: Path) -> None:
    store, view = tmp_path / "blobs", tmp_path / "snapshot"
    write_packs(view / "packs.jsonl", PACKS[:1])
    store.mkdir()
    for n, file in enumerate(sorted(view.iterdir())):
        shutil.move(file, store / f"{n}")
        file.symlink_to(store / f"{n}")
    data = (view / "packs.jsonl").read_bytes()
    assert find_manifest(view / "packs.jsonl", data) == view / "packs.jsonl.manifest.json"
