"""Parts of which as many as fit are packed, at once or after everything else."""

from dataclasses import replace
from pathlib import Path

import pytest
from trimesh import creation

from packit_sim import BoxType, Limits, PackSettings, Part, pack
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.results.summary import summary, table
from packit_sim.parts.results.verification import verify_packing
from tests.runs import packit

QUICK = PackSettings(workers=1, iterations=100)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    creation.box((10, 10, 10)).export(tmp_path / "cube.stl")
    creation.box((20, 20, 10)).export(tmp_path / "slab.stl")
    return tmp_path


def test_as_many_as_fit_are_packed_and_none_is_missed(folder: Path) -> None:
    packed = pack([f"{folder / 'cube.stl'}=max"], (30, 20, 20), settings=QUICK)
    assert packed.count == 12 and packed.task.parts[0].part.count == 12
    packed = pack([f"{folder / 'cube.stl'}=max"], (35, 29, 20), settings=QUICK)
    assert packed.count == 12 and packed.task.parts[0].part.count == 20
    assert packed.missed == () and packed.left_out[0].count == 8
    assert table(packed).splitlines()[1].split() == ["cube", "max", "12"]
    assert summary(packed)["packed"] == "12 parts"


def test_filling_up_takes_no_space_from_others(folder: Path) -> None:
    parts = [f"{folder / 'cube.stl'}=fill", f"{folder / 'slab.stl'}=2"]
    packed = pack(parts, (30, 20, 20), settings=QUICK)
    assert packed.counts == {0: 4, 1: 2}
    worth = replace(QUICK, iterations=60)
    packed = pack(parts, (20, 20, 20), "count", settings=worth)
    assert packed.counts == {1: 2}


@pytest.mark.parametrize(("word", "count"), [("max", 4), (" Fill ", 4), ("3", 3)])
def test_a_manifest_has_the_same_words(folder: Path, word: str, count: int) -> None:
    (folder / "parts.csv").write_text(f"file,count\ncube.stl,{word}\n")
    packed = pack([folder / "parts.csv"], (20, 20, 10), settings=QUICK)
    assert packed.count == count and packed.missed == ()


def test_a_manifest_is_taken_as_often_as_it_fits(folder: Path) -> None:
    (folder / "parts.csv").write_text("file,count\ncube.stl,2\n")
    assert pack([f"{folder / 'parts.csv'}=max"], (20, 20, 10), settings=QUICK).count == 4


def test_a_record_of_as_many_as_fit_is_verified_and_resumed(folder: Path) -> None:
    parts, out = [f"{folder / 'cube.stl'}=max", folder / "slab.stl"], folder / "out"
    packed = pack(parts, (30, 25, 20), settings=QUICK, out=out)
    assert verify_packing(out / "packing.json").is_valid
    assert "<td>max</td>" in (out / "packing.html").read_text()
    again = pack(parts, (30, 25, 20), settings=QUICK, out=out)
    assert again.searches == packed.searches + 1 and again.count >= packed.count


def test_words_that_are_no_counts_are_errors(folder: Path) -> None:
    with pytest.raises(ArgumentError, match=r"'many' is not a count.*or max or fill"):
        pack([f"{folder / 'cube.stl'}=many"], (20, 20, 10), settings=QUICK)
    (folder / "parts.csv").write_text("file,count\ncube.stl,many\n")
    with pytest.raises(ArgumentError, match="count 'many' is not a whole number, max or fill"):
        pack([folder / "parts.csv"], (20, 20, 10), settings=QUICK)
    with pytest.raises(ArgumentError, match="'cube': as many as fit needs a number of boxes"):
        pack([f"{folder / 'cube.stl'}=max"], (20, 20, 10), "boxes", settings=QUICK)


def test_a_record_in_which_none_of_as_many_as_fit_is_packed_is_verified(folder: Path) -> None:
    """The record has no mesh of such a part, so that a check can't prepare it again."""
    parts, out = [f"{folder / 'slab.stl'}=2", f"{folder / 'cube.stl'}=max"], folder / "out"
    box = BoxType((100, 100, 100), limits=Limits(max_parts=2))
    packed = pack(parts, box, settings=QUICK, out=out)
    assert packed.packed_of_asked == "2 parts"
    cubes = next(line for line in table(packed).splitlines() if line.startswith("cube"))
    assert cubes.split(maxsplit=3) == ["cube", "max", "0", "a limit of the box is reached"]
    assert verify_packing(out / "packing.json").is_valid


def test_the_command_misses_none_of_as_many_as_fit(folder: Path) -> None:
    found = packit(
        *("pack", f"{folder / 'cube.stl'}=max", "--box", "25x20x10mm", "--time", "1s"),
        *("--require-all", "--out", folder / "out"),
    )
    assert "4 parts" in found


def test_a_thousand_are_counted_before_they_are_packed() -> None:
    part = Part("grain", creation.box((1, 1, 1)), count=10_000, as_many_as_fit=True)
    packed = pack([part], (10, 10, 10), settings=QUICK)
    assert packed.count == packed.task.parts[0].part.count == 1000
