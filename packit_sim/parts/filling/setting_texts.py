"""Settings of a packing as text with units: those of the command line and of the workbench."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from packit_sim.core.errors import about
from packit_sim.core.length_units import Unit
from packit_sim.parts.filling.settings import PackSettings
from packit_sim.parts.reading.box_lists import without_lists
from packit_sim.parts.reading.boxes import box_unit
from packit_sim.parts.reading.distances import read_wall_clearance
from packit_sim.parts.reading.limits import read_limits
from packit_sim.parts.reading.named_containers import without_names
from packit_sim.parts.reading.powder import read_powder
from packit_sim.parts.reading.units import lengths


def read_settings(
    box: Sequence[str],
    unit: Unit,
    *,
    clearance: str = "0",
    clearance_z: str | None = None,
    wall_clearance: str = "0",
    accuracy: str | None = None,
    stable: str | None = None,
    max_mass: Sequence[str] = (),
    max_parts: Sequence[str] = (),
    balance: Sequence[str] = (),
    powder: str | None = None,
    **others: Any,
) -> PackSettings:
    """Read the settings of a packing.

    Parameters
    ----------
    box : sequence of str
        The boxes, whose first unit is that of lengths without one and of the result.
    unit : str
        The same unit, if no box names one.
    **others : object
        Further settings of `PackSettings`, which are no text.

    Returns
    -------
    PackSettings
        The settings.

    Raises
    ------
    ArgumentError
        If a text is not possible; its `setting` is the name of the parameter.
    """
    with about("box"):
        length = box_unit(without_names(without_lists(box)[0])[0]) or unit
    texts = {
        "clearance": clearance,
        "clearance_z": clearance_z,
        "accuracy": accuracy,
        "stable": stable,
    }
    read: dict[str, Any] = {}
    for name, text in texts.items():
        with about(name):
            read[name] = None if text is None else lengths(text, 1, length)[0]
    with about("wall_clearance"):
        walls = read_wall_clearance(wall_clearance, length)
    limits = read_limits(max_mass, max_parts, balance)
    with about("powder"):
        read["powder"] = None if powder is None else read_powder(powder)
    return PackSettings(unit=length, wall_clearance=walls, limits=limits, **read, **others)
