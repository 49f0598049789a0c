"""Folders of results: only files that `pack` wrote are replaced, and a result is there or not."""

from __future__ import annotations

import copy
import errno
import json
import os
import pickle
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from trimesh import creation

from packit_sim import PackSettings, Part, pack
from packit_sim.core.errors import ArgumentError, BusyError
from packit_sim.core.files import claimed, digest_of
from packit_sim.geometry.quantized import QuantizedMesh
from packit_sim.parts import check, export
from packit_sim.parts.filling.packed import PackedParts
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.reading.file_copies import FileCopies
from packit_sim.parts.reading.files import find_parts
from packit_sim.parts.results import exports
from packit_sim.render import video
from packit_sim.render.image_files import RGBImage
from tests.runs import packit, run_packit

QUICK = PackSettings(workers=1, iterations=5)

BOX = (100, 100, 60)


def stl(file: Path, *sides: float) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    creation.box(sides).export(file)
    return file


@pytest.fixture(name="quick_exports", autouse=True)
def _quick_exports(monkeypatch) -> None:
    """Write few bytes instead of pictures and the page."""
    for name in ("draw", "write_page"):
        monkeypatch.setattr(exports, name, lambda *given: path_of(given).write_bytes(b"exported"))


def path_of(given: tuple[object, ...]) -> Path:
    return next(each for each in given if isinstance(each, Path))


def contents(folder: Path) -> dict[str, bytes]:
    return {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file()
    }


def recorded(folder: Path) -> dict[str, str]:
    return dict(json.loads((folder / "packing.json").read_text())["files"])


def test_all_files_are_recorded_with_their_digests(tmp_path) -> None:
    out = tmp_path / "out"
    pack([stl(tmp_path / "a.stl", 4, 3, 2)], BOX, out=out, settings=QUICK)
    files = recorded(out)
    assert {name: digest_of(out / name) for name in files} == files
    assert {*contents(out)} == {*files, "packing.json"} and len(files) == 6


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("packing.stl", {}),
        ("packing.png", {}),
        ("packing.html", {}),
        ("packing.json", {}),
        ("instructions.html", {"instructions": True}),
        ("packing.gif", {"film": True}),
    ],
)
def test_files_of_others_are_not_replaced(tmp_path, monkeypatch, name, options) -> None:
    monkeypatch.setattr("packit_sim.parts.pack.PackingSearch", None)  # refused before the search
    (tmp_path / name).write_text("mine")
    with pytest.raises(ArgumentError, match=rf"{name}.* not of `packit pack`.*--force"):
        pack([Part("a", creation.box((4, 3, 2)))], BOX, out=tmp_path, settings=QUICK, **options)
    assert contents(tmp_path) == {name: b"mine"}
    with pytest.raises(TypeError):  # with it there would be a search
        pack([Part("a", creation.box((4, 3, 2)))], BOX, out=tmp_path, settings=QUICK, force=True)


def test_files_of_others_next_to_a_result_survive_it(tmp_path) -> None:
    mine = {"notes.txt", "packing-7.png", "instructions.html", "packing.gif", "meshes/a.stl"}
    for name in mine:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("mine")
    part = stl(tmp_path / "a.stl", 4, 3, 2)
    for _ in range(2):
        pack([part], BOX, out=tmp_path, settings=QUICK)
    assert all((tmp_path / name).read_text() == "mine" for name in mine)


def test_force_replaces_what_is_in_the_way_and_nothing_else(tmp_path) -> None:
    for name in ("packing.json", "packing.stl", "packing-1.stl", "notes.txt"):
        (tmp_path / name).write_text("mine")
    pack([Part("a", creation.box((4, 3, 2)))], BOX, out=tmp_path, settings=QUICK, force=True)
    mine = [name for name, content in contents(tmp_path).items() if content == b"mine"]
    assert sorted(mine) == ["notes.txt", "packing-1.stl"]
    assert verify_packing(tmp_path / "packing.json").is_valid


@pytest.mark.parametrize("place", ["packing.stl", "meshes"])
def test_a_file_that_was_changed_is_the_users(tmp_path, place) -> None:
    part, out = stl(tmp_path / "a.stl", 4, 3, 2), tmp_path / "out"
    pack([part], BOX, out=out, settings=QUICK)
    (file,) = (out / "meshes").iterdir() if place == "meshes" else [out / place]
    file.write_text("changed")
    before = contents(out)
    with pytest.raises(ArgumentError, match=rf"{file.name}.* or changed since"):
        pack([part], BOX, out=out, settings=QUICK)
    assert contents(out) == before
    pack([part], BOX, out=out, settings=QUICK, force=True)
    assert file.read_bytes() != b"changed" and verify_packing(out / "packing.json").is_valid


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("fit {part} --box 9x9x9 --packing {file}", "packing.json"),
        ("execute starter --stored --film {file}", "film.gif"),
        ("execute starter --stored --film {file}", "film.mp4"),
        ("record starter --transitions --out {folder}", "000003.npz"),
        ("demo --out {folder}", "best.png"),
        ("reproduce table1 --quick --out {folder}", "table1.json"),
        pytest.param(
            "datasets archive starter --out {folder}/new", "new.zip", marks=pytest.mark.slow
        ),
    ],
)
def test_other_commands_do_not_replace_files_of_others(
    tmp_path, monkeypatch, command, name
) -> None:
    for work in ("fit", "game.evaluation.executed.execute_pack"):
        monkeypatch.setattr(f"packit_sim.{work}", None)  # refused before it
    part, file = stl(tmp_path / "a.stl", 4, 3, 2), tmp_path / "own" / name
    file.parent.mkdir()
    file.write_text("mine")
    done = run_packit(*command.format(part=part, file=file, folder=file.parent).split())
    assert done.returncode == 2 and f"{file} exists" in done.stderr, done
    assert contents(file.parent) == {name: b"mine"}


def test_a_training_begins_in_a_folder_without_such_files(tmp_path) -> None:
    folders = pytest.importorskip("packit_agents.learning.run_folder")  # needs torch
    (tmp_path / "best.safetensors").write_text("mine")
    with pytest.raises(
        ArgumentError, match=r"best\.safetensors exists, and this command did not write it"
    ):
        folders.RunFolder(tmp_path, {"settings": 1})
    folder = tmp_path / "training"
    folders.RunFolder(folder, {"settings": 1})
    (folder / "best.safetensors").write_text("written by the training")
    folders.RunFolder(folder, {"settings": 1})


def test_the_part_that_is_fitted_is_not_replaced(tmp_path) -> None:
    part = stl(tmp_path / "a.stl", 4, 3, 2)
    before = part.read_bytes()
    done = run_packit("fit", part, "--box", "9x9x9", "--packing", part)
    assert done.returncode == 2 and "a.stl is an input, and would be replaced" in done.stderr
    assert part.read_bytes() == before


def test_links_are_not_followed(tmp_path) -> None:
    out, mine = tmp_path / "out", tmp_path / "mine"
    mine.mkdir()
    (mine / "file").write_text("mine")
    part = Part("a", creation.box((4, 3, 2)))
    for name, target in (("packing.stl", mine / "file"), ("meshes", mine), ("packing.json", mine)):
        out.mkdir(exist_ok=True)
        (out / name).symlink_to(target)
        for force in (False, True):
            with pytest.raises(ArgumentError, match=rf"{name} is not a regular file"):
                pack([part], BOX, out=out, settings=QUICK, force=force)
        (out / name).unlink()
    assert contents(mine) == {"file": b"mine"}


def test_a_forged_record_does_not_let_other_files_be_removed(tmp_path) -> None:
    part, out = Part("a", creation.box((4, 3, 2))), tmp_path / "out"
    pack([part], BOX, out=out, settings=QUICK)
    (out / "notes.txt").write_text("mine")
    (tmp_path / "mine.stl").write_text("mine")
    digest = digest_of(out / "notes.txt")
    record = json.loads((out / "packing.json").read_text())
    names = ("notes.txt", "../mine.stl", "meshes/../notes.txt", "meshes/../../mine.stl")
    record["files"] |= dict.fromkeys((*names, str(tmp_path / "mine.stl")), digest)
    (out / "packing.json").write_text(json.dumps(record))
    pack([part], BOX, out=out, settings=QUICK)
    assert (out / "notes.txt").exists() and (tmp_path / "mine.stl").exists()


def test_an_output_is_never_an_input(tmp_path) -> None:
    out = tmp_path / "out"
    pack([stl(tmp_path / "a.stl", 4, 3, 2)], BOX, out=out, settings=QUICK)
    (mesh,) = (out / "meshes").iterdir()
    os.link(out / "packing.stl", tmp_path / "link.stl")
    (tmp_path / "packing.json").write_text('[{"file": "a.stl"}]')
    before = contents(tmp_path)
    for force in (False, True):
        for source in (mesh, out / "packing.stl", tmp_path / "link.stl"):
            with pytest.raises(ArgumentError, match=f"{source.name} is an input"):
                pack([source], BOX, out=out, settings=QUICK, force=force)
        around = replace(QUICK, keep_out=[mesh])
        with pytest.raises(ArgumentError, match=f"{mesh.name} is an input"):
            pack([tmp_path / "a.stl"], BOX, out=out, settings=around, force=force)
    with pytest.raises(ArgumentError, match=r"packing.json is an input"):
        pack([tmp_path / "packing.json"], BOX, out=tmp_path, settings=QUICK, force=True)
    assert contents(tmp_path) == before


def test_a_source_in_the_folder_of_meshes_keeps_its_content(tmp_path) -> None:
    out = tmp_path / "out"
    sources = [stl(tmp_path / "x/a.stl", 11, 11, 11), stl(out / "meshes/a.stl", 33, 22, 22)]
    before = sources[1].read_bytes()
    packed = pack(sources, BOX, out=out, settings=QUICK)
    assert sources[1].read_bytes() == before and len(recorded(out)) == 7
    report = verify_packing(out / "packing.json")
    assert report.is_valid and report.volume == pytest.approx(packed.volume)


@pytest.mark.parametrize("change", ["gone", "other", "broken"])
def test_a_source_is_read_once(tmp_path, change) -> None:
    part, out = stl(tmp_path / "a.stl", 40, 30, 20), tmp_path / "out"
    original = part.read_bytes()

    def disturb(packed: PackedParts, _: float) -> None:
        if change == "gone":
            part.unlink(missing_ok=True)
        elif change == "other":
            stl(part, 90, 90, 50)
        else:
            part.write_bytes(b"no mesh any more")

    packed = pack([part], BOX, out=out, settings=QUICK, callback=disturb)
    assert check(packed).problems == () and verify_packing(out / "packing.json").is_valid
    (mesh,) = (out / "meshes").iterdir()
    assert mesh.read_bytes() == original


def test_a_changed_part_leaves_the_earlier_packing_until_its_record_is_replaced(
    tmp_path, monkeypatch
) -> None:
    part, out = stl(tmp_path / "a.stl", 40, 30, 20), tmp_path / "out"
    pack([part], BOX, out=out, settings=QUICK)
    volume = verify_packing(out / "packing.json").volume
    stl(part, 70, 60, 50)
    real, seen = os.replace, []

    def look(*paths: Path) -> None:
        if str(paths[1]).endswith("packing.json"):
            report = verify_packing(out / "packing.json")
            seen.append((report.is_valid, report.volume))
        real(*paths)

    monkeypatch.setattr(os, "replace", look)
    pack([part], BOX, out=out, settings=QUICK)
    new = pytest.approx(210_000)
    assert seen == [(True, pytest.approx(volume)), (True, new), (True, new)]
    assert len(list((out / "meshes").iterdir())) == 1  # the earlier one is gone


def test_a_file_that_appears_during_the_search_stays(tmp_path, caplog) -> None:
    def appear(packed: PackedParts, _: float) -> None:
        (tmp_path / "packing.stl").write_text("mine")

    part = Part("a", creation.box((4, 3, 2)))
    pack([part], BOX, out=tmp_path, settings=QUICK, callback=appear)
    assert (tmp_path / "packing.stl").read_text() == "mine"
    assert "packing.stl is not written: another program wrote that name" in caplog.text
    assert "packing.stl" not in recorded(tmp_path) and (tmp_path / "packing.glb").exists()


def test_a_full_disk_has_the_path_of_the_file(tmp_path, monkeypatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    packed = pack([Part("a", creation.box((4, 3, 2)))], BOX, settings=QUICK)
    monkeypatch.setattr(exports, "draw", full)
    with pytest.raises(OSError, match=r"packing.png") as caught:
        export(packed, tmp_path)
    assert caught.value.filename == str(tmp_path / "packing.png")
    assert {"packing.json", "meshes"} == {file.name for file in tmp_path.iterdir()}
    assert verify_packing(tmp_path / "packing.json").is_valid


def test_a_lock_of_others_is_not_removed(tmp_path) -> None:
    (tmp_path / ".lock").write_text("mine")
    with (
        pytest.raises(BusyError, match=r"\.lock is in the way"),
        claimed(tmp_path / ".lock", tmp_path),
    ):
        pass
    assert (tmp_path / ".lock").read_text() == "mine"


def test_copies_can_be_copied_and_pickled(tmp_path) -> None:
    (part,) = find_parts([stl(tmp_path / "a.stl", 4, 3, 2)]).parts
    for other in (copy.deepcopy(part), pickle.loads(pickle.dumps(part))):
        assert other.copy.content == (tmp_path / "a.stl").read_bytes()
        assert other.copy.digest == part.copy.digest


def test_many_copies_have_one_file(monkeypatch) -> None:
    monkeypatch.setattr("packit_sim.parts.reading.file_copies._IN_MEMORY", 10_000)
    copies = FileCopies()
    before = len(os.listdir("/proc/self/fd"))
    found = [copies.add({"a": bytes([n % 256]) * 1000, "b": b"other"}) for n in range(1000)]
    assert len(os.listdir("/proc/self/fd")) <= before + 1
    assert all(each.content == bytes([n % 256]) * 1000 for n, each in enumerate(found))
    assert found[7].others["b"].content == b"other"


def test_the_command_refuses_and_forces(tmp_path) -> None:
    part = stl(tmp_path / "a.stl", 4, 3, 2)
    (tmp_path / "packing.stl").write_text("mine")
    command = ("pack", part, "--box", "9x9x9mm", "--iterations", 5, "--workers", 1, "-o", tmp_path)
    with pytest.raises(ArgumentError, match=r"packing.stl is not of `packit pack`"):
        packit(*command)
    assert (tmp_path / "packing.stl").read_text() == "mine"
    packit(*command, "--force")
    assert (tmp_path / "packing.stl").read_bytes() != b"mine"


# Files that a user names


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("render starter -o", "picture.png"),
        ("film starter -o", "film.gif"),
        ("export starter -o", "box.glb"),
        ("export starter -o", "box.json"),
        ("datasets stats starter --json", "counts.json"),
        ("score starter --out", "scores.json"),
        ("evaluate starter --out", "results.jsonl"),
        ("nest cut-cube-8 --out", "solution.json"),
        ("nest cut-cube-8 --packing", "packing.json"),
        ("nest cut-cube-8 --instance-out", "instance.json"),
    ],
)
def test_a_file_of_another_kind_is_not_replaced(tmp_path, command, name) -> None:
    file = tmp_path / name
    kinds = ("mine", '[{"file": "a.stl"}]') if "nest" in command else ("mine",)
    for content in kinds:
        file.write_text(content)
        with pytest.raises(ArgumentError, match=rf"{name} exists, and is not a file that this"):
            packit(*command.split(), file)
        assert contents(tmp_path) == {name: content.encode()}


NEST = ("--iterations", 1, "--workers", 1)


def test_nest_replaces_its_own_files_and_no_input(tmp_path) -> None:
    outputs = {name: tmp_path / f"{name}.json" for name in ("out", "packing", "instance-out")}
    options = [each for name, file in outputs.items() for each in (f"--{name}", file)]
    for _ in range(2):
        packit("nest", "rings-12", *NEST, *options)
    instance = outputs["instance-out"]
    before = contents(tmp_path)
    (mesh, *_) = sorted((tmp_path / "instance-out").iterdir())
    for option, output in (("--instance-out", instance), ("--packing", instance), ("--out", mesh)):
        with pytest.raises(ArgumentError, match=r"is an input|exists, and is not a file"):
            packit("nest", instance, *NEST, option, output)
    mesh.write_text("mine")
    with pytest.raises(ArgumentError, match=rf"{mesh.name} exists with other content"):
        packit("nest", "rings-12", *NEST, *options)
    mesh.write_bytes(before[mesh.relative_to(tmp_path).as_posix()])
    assert contents(tmp_path) == before
    new = tmp_path / "new.json"
    with pytest.raises(ArgumentError, match="two outputs have the same name"):
        packit("nest", "rings-12", *NEST, "--out", new, "--instance-out", new)


def test_meshes_next_to_an_exported_packing_are_not_replaced(tmp_path) -> None:
    file = tmp_path / "box.json"
    for _ in range(2):
        packit("export", "starter", "-o", file)
    mesh = next((tmp_path / "box-meshes").iterdir())
    mesh.write_text("mine")
    with pytest.raises(ArgumentError, match=rf"{mesh.name} exists with other content"):
        packit("export", "starter", "-o", file)
    assert mesh.read_text() == "mine"


def test_errors_of_the_disk_without_a_path_get_one(tmp_path) -> None:
    def pictures() -> Iterator[RGBImage]:
        raise OSError(errno.EFBIG, "File too large")
        yield

    with pytest.raises(OSError, match=r"f\.gif"):
        video.write(tmp_path / "f.gif", pictures(), 5)
    mesh = QuantizedMesh(np.zeros((3, 3), np.uint16), np.zeros((1, 3), np.uint16), np.ones(3))
    (tmp_path / "full.npz").symlink_to("/dev/full")
    with pytest.raises(OSError, match=r"full\.npz"):
        mesh.save(tmp_path / "full.npz")
