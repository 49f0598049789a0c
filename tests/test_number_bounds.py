"""Numbers have the same bounds at every door: options, Python, manifests, orders and records."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest
from trimesh import creation
from typer.testing import CliRunner

from packit_sim import BoxContainer, BoxType, PackSettings, Part, nest, pack
from packit_sim.cli.app import app
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.reading.boxes import box_types
from packit_sim.parts.reading.files import find_parts
from packit_sim.parts.reading.units import lengths

CUBE = creation.box((10, 10, 10))
LONG = 10**5000  # more digits than Python prints
SIDE = "1" * 400


@pytest.mark.parametrize("text", ["1e308mm", "1e31mm", "1e400", SIDE, f"{SIDE}mm", "1e30m"])
@pytest.mark.parametrize("sides", ["{}", "10x10x{}"])
def test_a_text_of_an_impossible_length(sides: str, text: str) -> None:
    sides = sides.format(text)
    with pytest.raises(ArgumentError, match=r"is not possible: lengths are 0 to 1e\+30") as raised:
        box_types(sides, "mm", 1) if "x" in sides else lengths(sides, 1, "mm")
    assert len(str(raised.value)) < 300


PYTHON: dict[str, Callable[[], object]] = {
    "side": lambda: BoxContainer((LONG, 1, 1)),
    "sides": lambda: BoxContainer((1, 1, 10**400)),
    "small side": lambda: BoxContainer((1e-31, 1, 1)),
    "box": lambda: BoxType((1, 1, 1e31)),
    "boxes": lambda: BoxType((1, 1, 1), count=LONG),
    "count": lambda: Part("a", CUBE, count=LONG),
    "priority": lambda: Part("a", CUBE, priority=LONG),
    "small priority": lambda: Part("a", CUBE, priority=-LONG),
    "value": lambda: Part("a", CUBE, value=1e13),
    "mass": lambda: Part("a", CUBE, mass=LONG),
    "density": lambda: Part("a", CUBE, density=math.nan),
    "max_load": lambda: Part("a", CUBE, max_load=1e300),
    "unit_cm": lambda: Part("a", CUBE, unit_cm=1e300),
    "text": lambda: Part("a", CUBE, mass="heavy"),  # type: ignore[arg-type]
    "clearance": lambda: PackSettings(clearance=1e308),
    "wall clearance": lambda: PackSettings(wall_clearance=LONG),
    "accuracy": lambda: PackSettings(accuracy=1e-300),
    "stable": lambda: PackSettings(stable=math.inf),
    "iterations": lambda: PackSettings(iterations=LONG),
    "number of boxes": lambda: PackSettings(boxes=10_001),
    "time": lambda: pack([Part("a", CUBE)], "20x20x20mm", time=1e308),
    "seed": lambda: pack([Part("a", CUBE)], "20x20x20mm", seed=LONG),
    "time of nest": lambda: nest([ItemType("a", CUBE.vertices, CUBE.faces)], (20, 20, 20), time=-1),
    "seed of nest": lambda: nest(
        [ItemType("a", CUBE.vertices, CUBE.faces)], (20, 20, 20), seed=LONG
    ),
}


@pytest.mark.parametrize("name", PYTHON)
def test_an_argument_out_of_bounds(name: str) -> None:
    with pytest.raises(ArgumentError, match=r"is not possible: ") as raised:
        PYTHON[name]()
    assert "4300" not in str(raised.value) and len(str(raised.value)) < 300


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("mass", "1e308"),
        ("density", "1e-300"),
        ("value", SIDE),
        ("max_load", "1e400"),
        ("count", "9" * 39),
        ("count", "9" * 5000),
        ("priority", "9" * 30),
        ("priority", "-" + "9" * 5000),
    ],
)
@pytest.mark.parametrize("form", ["m.csv", "m.json"])
def test_a_row_out_of_bounds_is_named(tmp_path: Path, form: str, column: str, value: str) -> None:
    CUBE.export(tmp_path / "a.stl")
    texts = {
        "m.csv": f"file,{column}\na.stl,{value}\na.stl,\n",
        "m.json": f'[{{"file": "a.stl", "{column}": "{value}"}}, {{"file": "a.stl"}}]',
    }
    (tmp_path / form).write_text(texts[form])
    found = find_parts([tmp_path / form])
    assert len(found.parts) == 1
    (unread,) = found.unread
    assert column in unread.reason and "is not possible: " in unread.reason
    assert len(unread.reason) < 300


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--box", f"{SIDE}x1x1mm"], "lengths are 0 to 1e+30 mm"),
        (["--box", "9x9x9mm", "--clearance", "1e308mm"], "lengths are 0 to 1e+30 mm"),
        (["--box", "9x9x9mm", "--wall-clearance", SIDE], "lengths are 0 to 1e+30 mm"),
        (["--box", "9x9x9mm", "--stable", "1e300m"], "lengths are 0 to 1e+30 mm"),
        (["--box", "9x9x9mm", "--time", "1e308h"], "time inf is not possible"),
        (["--box", "9x9x9mm", "--iterations", "9" * 30], "iterations"),
        (["--box", "9x9x9mm", "--seed", "9" * 30], "seed"),
        (["--box", "9x9x9mm", "--boxes", "9" * 30], "boxes"),
    ],
)
def test_an_option_out_of_bounds(tmp_path: Path, options: list[str], message: str) -> None:
    CUBE.export(tmp_path / "a.stl")
    run = CliRunner().invoke(app, ["pack", str(tmp_path / "a.stl"), *options, "-o", str(tmp_path)])
    assert run.exit_code == 2 or isinstance(run.exception, ArgumentError)
    assert message in (run.output + str(run.exception)).replace("\n", " ")
