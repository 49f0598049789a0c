"""Readers of what options of `packit pack` take: lists of boxes, containers, presets and texts."""

from __future__ import annotations

import json
from typing import Any
from unittest import mock

import typer
from typer.main import get_command

from campaigns.fuzzing import file_changes, world
from campaigns.fuzzing.json_changes import json_tree
from campaigns.fuzzing.reader import Reader
from packit_sim.cli.app import app
from packit_sim.core.configuration import CONFIG_VARIABLE
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.filling.setting_texts import read_settings
from packit_sim.parts.reading.box_lists import without_lists
from packit_sim.parts.reading.boxes import box_types, box_unit
from packit_sim.parts.reading.named_containers import FILE, named_containers
from packit_sim.parts.reading.turnings import read_turning

_BOXES = (
    "box,name,count,max_mass,max_parts,balance\r\n30x20x10cm,A,2,20kg,12,10%\r\n9x9x9in,B,,,,\r\n",
    "box;count\ncylinder:220x300mm;3\n300x200x150;1\n",
)
_CONTAINERS = (
    '[crate]\nsize = "60x40x30cm"\nkind = "crate"\nmax_mass = "20kg"\nmax_parts = 40\n'
    '[round-1]\nsize = "cylinder:22x30in"\nsource = "https://example.org"\n'
)
_PRESET = {
    "command": "pack",
    "options": {"box": ["9x9x9"], "clearance": "2mm", "boxes": 3, "removable": True, "down": None},
}
_TEXTS = (
    "powder 0.45:20%\nbalance A:10%\nmax_mass 2.5lb\nmax_parts A:12\nmax_tilt 15deg\ndown z-,x+\n"
)


def _read_boxes(data: bytes) -> None:
    boxes, _ = without_lists(str(world.written("lists/boxes.csv", data)))
    box_types(boxes, box_unit(boxes) or "mm", 1)


def _read_containers(data: bytes) -> None:
    folder = world.written(f"containers/{FILE}", data).parent
    with mock.patch.dict("os.environ", {CONFIG_VARIABLE: str(folder)}):
        named_containers()


def _read_preset(data: bytes) -> None:
    file = world.written("presets/preset.json", data)
    commands: Any = get_command(app)
    try:
        commands.get_command(None, "pack").make_context(
            "pack", ["a.stl", "--out", "x", "--preset", str(file)]
        )
    except typer.TyperException as error:  # such as a required option that is missing
        raise ArgumentError(error.format_message()) from None


def _read_texts(data: bytes) -> None:
    """Read a line for each option, as a command line has them."""
    given: dict[str, str] = {}
    for line in data.decode("utf-8", "surrogateescape").split("\n"):
        name, _, text = line.partition(" ")
        given[name] = text
    several: Any = {
        name: [given[name]] for name in ("max_mass", "max_parts", "balance") if name in given
    }
    read_turning(given.get("max_tilt"), given.get("down"))
    read_settings(["A:9x9x9mm"], "mm", powder=given.get("powder"), **several)


READERS = (
    Reader(
        "box-lists",
        "lists of boxes",
        lambda: [text.encode() for text in _BOXES],
        _read_boxes,
        file_changes.tokens,
    ),
    Reader(
        "named-containers",
        "containers with names (TOML)",
        lambda: [_CONTAINERS.encode()],
        _read_containers,
        file_changes.toml,
    ),
    Reader("presets", "presets", lambda: [json.dumps(_PRESET).encode()], _read_preset, json_tree),
    Reader(
        "limits",
        "limits and powder as text",
        lambda: [_TEXTS.encode()],
        _read_texts,
        file_changes.tokens,
    ),
)
"""The readers of this module."""
