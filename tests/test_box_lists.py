"""Lists of boxes: tables with a box in each row, its count and its limits."""

from pathlib import Path

import pytest
from trimesh import creation

from packit_sim import Limits, PackSettings, Part
from packit_sim.core.errors import ArgumentError, PackItError
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.reading.box_lists import without_lists

TABLE = """\
name;Box;count;max mass;max_parts;balance
parcel;300x200x150mm;2;20kg;12;10%
bed;cylinder:220x300mm;;;;
;60x40x30cm;3;;;
"""


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "boxes.csv"
    path.write_text(TABLE)
    return path


def test_each_row_is_a_box_with_its_limits(table: Path) -> None:
    boxes, limits = without_lists(["A:10x10x10mm", str(table)])
    assert boxes == [
        "A:10x10x10mm",
        "parcel:300x200x150mm=2",
        "bed:cylinder:220x300mm",
        "60x40x30cm=3",
    ]
    assert limits == {"parcel": Limits(20_000, 12, 0.1)}


def test_limits_of_the_row_come_before_those_for_all(table: Path) -> None:
    part = Part("a", creation.box((10, 10, 10)), mass=10)
    general = {"": Limits(max_parts=5), "parcel": Limits(max_mass=9000)}
    task = prepared_task([part], str(table), "volume", PackSettings(limits=general))
    assert [(box.name, box.count, box.limits) for box in task.boxes] == [
        ("parcel", 2, Limits(9000, 12, 0.1)),
        ("bed", 1, Limits(max_parts=5)),
        ("box", 3, Limits(max_parts=5)),
    ]
    assert task.boxes[2].size == (600, 400, 300)


def test_meshes_are_next_to_the_list(tmp_path: Path) -> None:
    creation.box((40, 40, 40)).export(tmp_path / "case.stl")
    path = tmp_path / "boxes.csv"
    path.write_text("box,count\ncase.stl,2\n")
    part = Part("a", creation.box((10, 10, 10)))
    task = prepared_task([part], str(path), "volume", PackSettings())
    assert [(box.name, box.count, box.size) for box in task.boxes] == [("case", 2, (40, 40, 40))]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name\nA\n", "its first row is name: choose each at most once from box, name, count"),
        ("box,colour\n1x1x1mm,red\n", "its first row is box, colour"),
        ("box\n", "it has no boxes"),
        ("box,name\n,A\n", "row 2: it has no box"),
        ("box,count\n1x1x1mm,two\n", "row 2: count 'two' is not a whole number"),
        ("box\nA:1x1x1mm\n", "box 'A:1x1x1mm' is not possible: its name and count are other"),
        ("box,max_mass\n1x1x1mm,1kg\n", "row 2: a box with limits needs a name"),
        ("box,name,max_mass\n1x1x1mm,A,20\n", "row 2: '20' is not a mass with a unit"),
        ("box,name,balance\n1x1x1mm,A,B:9%\n", "row 2: its limits are for the row's own box"),
        ("box,count\n1x1x1mm,2,3\n", "row 2: it has more cells than the first row"),
    ],
)
def test_what_is_wrong_in_a_list(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "boxes.csv"
    path.write_text(text)
    with pytest.raises(ArgumentError, match=said):
        without_lists(str(path))


def test_a_list_that_there_is_not(tmp_path: Path) -> None:
    with pytest.raises(PackItError, match=r"none\.csv"):
        without_lists(str(tmp_path / "none.csv"))
