"""Containers by name: those that are public knowledge, and the user's own."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import msgspec

from packit_sim.core.assets import assets_folder
from packit_sim.core.configuration import config_folder
from packit_sim.core.errors import ArgumentError, located
from packit_sim.core.files import exists, read_whole
from packit_sim.parts.reading.boxes import Boxes, BoxType, OneBox
from packit_sim.parts.reading.limits import Limits, grams

FILE = "containers.toml"
"""The name of a file of containers."""

_NAME = r"[A-Za-z](?:[A-Za-z0-9-]*[A-Za-z0-9])?"

_NAMED = re.compile(rf"(?:(?P<name>[^:=]+):)?(?P<container>{_NAME})(?P<count>=\d{{1,30}})?")


class _Entry(msgspec.Struct, forbid_unknown_fields=True):
    """A container in a file."""

    size: str
    kind: str = ""
    source: str = ""
    max_mass: str | None = None
    max_parts: int | None = None


@dataclass(frozen=True)
class NamedContainer:
    """A container with a name.

    Attributes
    ----------
    name : str
        Its name, of letters, digits and hyphens.
    size : str
        Its size, as `--box` or `--container` takes it, with a unit.
    kind : str
        What it is, such as "powder bed".
    source : str
        Where its size is published.
    limits : Limits
        What it may hold.
    """

    name: str
    size: str
    kind: str
    source: str
    limits: Limits


def named_containers() -> dict[str, NamedContainer]:
    """Read all containers that have a name.

    Returns
    -------
    dict of str to NamedContainer
        The containers by name; of equal names, the user's own.

    Raises
    ------
    ArgumentError
        If the user's file is not one of containers.
    """
    found = _read(assets_folder() / "containers" / FILE)
    own = config_folder() / FILE
    return found | (_read(own) if exists(own) else {})


def without_names(boxes: Boxes) -> tuple[Boxes, dict[str, Limits]]:
    """Replace names of containers by their sizes.

    Parameters
    ----------
    boxes : str, BoxType, Container, or sequence of float, str, BoxType or Container
        The boxes.

    Returns
    -------
    boxes : Boxes
        The same, with texts as `BoxType.parse` reads them.
    limits : dict of str to Limits
        The limits of those that have some, by the names of the boxes.

    Raises
    ------
    ArgumentError
        If a text is a word, and no name of a container.
    """
    several: Any = [boxes] if isinstance(boxes, OneBox) else boxes
    found, limits = [], {}
    known: Mapping[str, NamedContainer] | None = None
    for each in several:
        match = _NAMED.fullmatch(each.strip()) if isinstance(each, str) else None
        if match is None or exists(Path(each)):
            found.append(each)
            continue
        known = named_containers() if known is None else known
        container = known.get(match["container"])
        if container is None:
            close = get_close_matches(match["container"], known, 1, 0.6)
            hint = f"is it {close[0]!r}? " if close else ""
            raise ArgumentError(
                f"container {match['container']!r} is not known: {hint}"
                "`packit containers` lists them"
            )
        name = (match["name"] or container.name).strip()
        found.append(f"{name}:{container.size}{match['count'] or ''}")
        if not container.limits.is_empty:
            limits[name] = container.limits
    return found, limits


def _read(file: Path) -> dict[str, NamedContainer]:
    """Read a file of containers."""
    with located(file, ArgumentError):
        try:
            content = read_whole(file).decode("utf-8-sig")  # editors on Windows write the mark
            entries = msgspec.toml.decode(content, type=dict[str, _Entry])
        except (msgspec.MsgspecError, ValueError, RecursionError) as error:
            raise ArgumentError(f"it is no file of containers: {error}") from None
        return {name: _container(name, entry) for name, entry in entries.items()}


def _container(name: str, entry: _Entry) -> NamedContainer:
    if not re.fullmatch(_NAME, name):
        raise ArgumentError(f"container {name!r}: its name must be of letters, digits and hyphens")
    with located(f"container {name!r}", ArgumentError):
        BoxType.parse(entry.size, "mm")
        mass = None if entry.max_mass is None else grams(entry.max_mass)
        limits = Limits(mass, entry.max_parts)
    return NamedContainer(name, entry.size, entry.kind, entry.source, limits)
