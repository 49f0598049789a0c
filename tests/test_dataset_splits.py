"""`packit generate --splits`: a dataset with three splits from one's own meshes."""

from pathlib import Path

import pytest
from trimesh import creation

from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets.pack_files import dataset_library, load_tasks, read_packs
from tests.runs import packit


@pytest.fixture
def meshes(tmp_path) -> Path:
    """Five different meshes, one of them twice and one of them open."""
    folder = tmp_path / "meshes"
    folder.mkdir()
    for n in range(4):
        creation.box((1, 1 + 0.4 * n, 2)).export(folder / f"block-{n}.stl")
    creation.box((1, 1.4, 2)).export(folder / "again.stl")
    tray = creation.box((3, 3, 1))
    tray.update_faces(tray.face_normals[:, 2] < 0.5)
    tray.export(folder / "tray.stl")
    return folder


def test_one_command_makes_a_dataset_with_splits_of_a_folder(
    meshes, tmp_path, in_this_process
) -> None:
    out = tmp_path / "mine"
    small = ("--pool", 3, "--generations", 0, "--population", 52, "--workers", 1)
    command = ("generate", "--library", meshes, "--splits", 1, 0, 1, *small, "--out", out)
    printed = " ".join(packit(*command).split())
    assert "train.jsonl: 1 packs" in printed and "test.jsonl: 1 packs" in printed
    assert "Open meshes: tray" in printed and "open: volume of a shell" in printed
    library = dataset_library(out)
    assert library.path == out / "library" and len(library) == 6
    used = {
        split: {item.shape for pack in read_packs(out / f"{split}.jsonl") for item in pack.items}
        for split in ("train", "test")
    }
    for split, ids in used.items():
        assert ids and ids <= set(library.split(split).ids)
    before = {file.name: file.read_bytes() for file in out.glob("*.jsonl")}
    assert "has been imported already" in packit(*command)
    assert {file.name: file.read_bytes() for file in out.glob("*.jsonl")} == before
    moved = out.rename(tmp_path / "moved")
    assert len(load_tasks(moved, split="train")) == 1
    (meshes / "block-0.stl").unlink()
    with pytest.raises(ArgumentError, match="is not the library of the meshes of"):
        packit("generate", "--library", meshes, "--splits", 1, 0, 1, *small, "--out", moved)


def test_splits_that_cannot_be_are_refused(meshes, tmp_path, in_this_process) -> None:
    command = ("generate", "--out", tmp_path / "mine")
    for options, message in (
        (("--splits", 1, 1, 1, "--packs", 3), "--packs has no effect with --splits"),
        (("--splits", 1, 1, 1, "--split", "test"), "--split has no effect with --splits"),
        (("--splits", 0, 0, 0), "--splits 0 0 0 is not possible"),
        (("--splits", 1, -1, 0), "--splits 1 -1 0 is not possible"),
        (("--splits", 1, 1, 1, "--puzzle", "curved"), "--splits has no effect with --puzzle"),
    ):
        with pytest.raises(ArgumentError, match=message):
            packit(*command, *options)
    for file in [*meshes.glob("block-[123]*"), *meshes.glob("tray*")]:
        file.unlink()
    with pytest.raises(ArgumentError, match="three different objects or more are needed"):
        packit(*command, "--library", meshes, "--splits", 1, 1, 1)


def test_the_volume_of_a_shell_is_named(meshes, tmp_path) -> None:
    shown = packit("shapes", "show", "tray", "--library", meshes)
    assert "of a shell: the surface is open" in " ".join(shown.split())
    printed = packit(
        "generate",
        "--library",
        meshes,
        "--pool",
        2,
        "--generations",
        0,
        "--workers",
        1,
        "--out",
        tmp_path / "mine",
    )
    assert "Open meshes: tray" in printed
