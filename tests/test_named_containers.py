"""Containers by name, and options of a run in a file."""

import json
from pathlib import Path

import pytest
from trimesh import creation

from packit_sim import CylinderContainer, Limits, PackSettings, Part
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.filling.preparation import prepared_task
from packit_sim.parts.reading.named_containers import named_containers, without_names
from tests.runs import packit

SETTINGS = PackSettings(workers=1, iterations=1)
BLOCK = creation.box((50, 40, 20))


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of settings."""
    monkeypatch.setenv("PACKIT_CONFIG", str(tmp_path / "config"))
    (tmp_path / "config").mkdir()
    return tmp_path / "config"


def test_every_container_has_a_kind_a_source_and_a_size_with_a_unit() -> None:
    found = named_containers()
    assert {each.kind for each in found.values()} == {
        *("powder bed", "resin", "filament", "pallet", "cabin bag", "parcel")
    }
    for each in found.values():
        assert len(each.source) > 10
        task = prepared_task([Part("a", BLOCK)], f"{each.name}=1", "count", SETTINGS)
        assert task.boxes[0].name == each.name
        assert task.boxes[0].container.volume / {"mm": 1e6, "cm": 1e3, "in": 61}[task.unit] > 0.5


def test_a_name_stands_for_its_size() -> None:
    boxes = ["eur-pallet-105=2", "A:flsun-v400", "40x40x40mm"]
    task = prepared_task([Part("a", BLOCK, mass=1.0)], boxes, "volume", SETTINGS)
    pallet, bed, box = task.boxes
    assert (pallet.name, pallet.size, pallet.count) == ("eur-pallet-105", (1200, 800, 906), 2)
    assert pallet.limits == Limits(max_mass=1_500_000)
    assert bed.form == CylinderContainer(300, 410, name="A")
    assert box.size == (40, 40, 40) and box.limits.is_empty
    own = {"eur-pallet-105": Limits(max_mass=5000), "": Limits(max_parts=3)}
    settings = PackSettings(workers=1, limits=own)
    first = prepared_task([Part("a", BLOCK, mass=1.0)], boxes, "volume", settings).boxes[0]
    assert first.limits == Limits(max_mass=5000, max_parts=3)


def test_a_published_mass_needs_no_masses() -> None:
    task = prepared_task([Part("a", BLOCK)], "dhl-packet-m", "volume", SETTINGS)
    assert task.boxes[0].limits.is_empty
    (note,) = task.notes
    assert note == (
        "dhl-packet-m may hold 2 kg, which is not considered: part 'a' has no mass or density"
    )


def test_own_containers_count_first(folder: Path) -> None:
    (folder / "containers.toml").write_text(
        '[crate-7]\nsize = "60x40x30cm"\nmax_mass = "20kg"\nmax_parts = 40\n'
        '[prusa-mk4]\nsize = "100x100x100mm"\n'
    )
    boxes, limits = without_names(["crate-7", "B:prusa-mk4=3"])
    assert boxes == ["crate-7:60x40x30cm", "B:100x100x100mm=3"]
    assert limits == {"crate-7": Limits(20_000, 40)}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[a", "no file of containers"),
        ('[a]\nkind = "crate"\n', "missing required field `size`"),
        ('[a]\nsize = "1x1x1mm"\ncolour = "red"\n', "unknown field `colour`"),
        ('[a]\nsize = "1x1mm"\n', "container 'a': '1x1mm' is not 3 lengths"),
        ('[a]\nsize = "1x1x1mm"\nmax_mass = "20"\n', "'20' is not a mass with a unit"),
        ('["a b"]\nsize = "1x1x1mm"\n', "'a b': its name must be of letters"),
    ],
)
def test_a_wrong_file_of_containers_is_named(text: str, said: str, folder: Path) -> None:
    (folder / "containers.toml").write_text(text)
    with pytest.raises(ArgumentError, match=said) as error:
        named_containers()
    assert str(folder / "containers.toml") in str(error.value)


def test_an_unknown_name_is_an_error() -> None:
    with pytest.raises(ArgumentError, match="'eur-palet' is not known: is it 'eur-pallet-"):
        prepared_task([Part("a", BLOCK)], "eur-palet", "volume", SETTINGS)


def test_options_are_kept_and_used_again(tmp_path: Path) -> None:
    BLOCK.export(tmp_path / "a.stl")
    pack = ["pack", str(tmp_path / "a.stl"), "--time", "0.1", "--workers", "1"]
    preset = tmp_path / "options.json"
    options = ["--container", "prusa-mini", "--clearance", "2mm", "--max-parts", "3", "--removable"]
    packit(*pack, *options, "--out", str(tmp_path / "one"), "--save-preset", str(preset))
    kept = json.loads(preset.read_text())["options"]
    assert kept == {
        "container": ["prusa-mini"],
        "clearance": "2mm",
        "max_parts": ["3"],
        "removable": True,
        "time": "0.1",
    }
    more = ["--clearance", "3mm", "--max-parts", "prusa-mini:4", "--out", str(tmp_path / "two")]
    packit("pack", str(tmp_path / "a.stl"), "--preset", str(preset), *more)
    request = json.loads((tmp_path / "two" / "packing.json").read_text())["request"]
    assert request["clearance"] == 3.0 and request["removable"]
    assert request["boxes"][0]["name"] == "prusa-mini" and request["boxes"][0]["max parts"] == 4


def test_containers_are_listed(folder: Path) -> None:
    (folder / "containers.toml").write_text('[crate-7]\nsize = "60x40x30cm"\nmax_parts = 40\n')
    text = packit("containers")
    assert "hp-jet-fusion-5200" in text and "380x284x380mm" in text
    assert "crate-7" in text and "40 parts" in text and str(folder) in text
