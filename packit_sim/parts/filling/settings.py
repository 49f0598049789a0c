"""The settings for reading and packing parts."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from packit_sim.core.checks import as_integer, check_range
from packit_sim.core.choices import Door, LoadingOrder, SearchBackend
from packit_sim.core.errors import about
from packit_sim.core.length_units import Unit, check_unit
from packit_sim.core.parallel import check_search_workers
from packit_sim.parts.filling.groups import GROUP_RULES
from packit_sim.parts.handling.constraints import CustomConstraint
from packit_sim.parts.handling.sweeps import check_door
from packit_sim.parts.packings.bounds import COUNTS, DISTANCES, ITERATIONS, LENGTHS
from packit_sim.parts.packings.distances import WallClearance, stretch
from packit_sim.parts.reading.files import ReadSettings
from packit_sim.parts.reading.limits import NO_LIMITS, Limits
from packit_sim.parts.reading.part import Part
from packit_sim.parts.reading.powder import Powder


@dataclass(frozen=True)
class PackSettings:
    """Settings for reading and packing parts.

    Parameters
    ----------
    clearance : float
        Smallest distance between two parts, unless one of them has a larger one.
    wall_clearance : float or WallClearance
        Smallest distance to the walls.
    accuracy : float, optional
        Largest deviation of a collision mesh from its file; by default 0.002 of its diagonal.
    boxes : int, optional
        How many boxes there are of a size that does not say so; by default 1, or for the objective
        "boxes" as many as are needed.
    unit : str, optional
        The unit of clearances and results, and of boxes if none of them names a unit; by default
        the first unit that a box names, or else mm.
    reading : ReadSettings
        How files are read.
    removable : bool
        Whether every part can be taken out of its box by straight moves, in some order.
    insertable : bool
        Whether every part can be put in by one straight move, in some order.
    stable : float, optional
        The largest distance that a part may move under gravity at any stage of packing.
    keep_out : sequence of Part, Path or str
        Volumes that stay free in every box, as meshes in the box's coordinates: parts keep the
        clearance from them.
    fixed : sequence of Part, Path or str
        Parts that are in the box already, as meshes in its coordinates. Others keep the clearance
        from them and may rest on them.
    constraints : sequence of CustomConstraint
        Further constraints on the parts in each box; parts that break one are left out.
    workers : int
        The number of searches at a time; 0: one per core.
    backend : str
        Where they run: "threads" of this process, or processes of a "ray" cluster.
    address : str, optional
        The address of the Ray cluster's head.
    iterations : int, optional
        Passes over the parts of each search, instead of the time: a repeatable search.
    stop : threading.Event, optional
        Ends the search early when another thread sets it, as Ctrl-C does.
    separable : bool
        Whether every part can be moved out without turning, in some order and round corners, as if
        the box had no walls: no parts interlock.
    limits : Limits or mapping of str to Limits
        What one box may hold, where a box does not say so; or the same by the name of the boxes,
        with those of all others by the name "".
    clearance_z : float, optional
        Smallest distance of two parts of which one is straight above the other; by default the
        same as `clearance`. Between, an ellipsoid with these half axes decides (see Notes).
    groups : sequence of str
        Rules for the parts of each group: "together": all that are packed share a box; "kit": they
        are packed whole, into one box, or not at all; "apart": no box has parts of two groups.
    powder : Powder, optional
        The powder of the bed, of which the summary has how much a build takes.
    even : bool
        Whether parts move after the search, none above the highest one, until the packed area
        varies less over the height.
    door : str
        The side through which parts come in and leave: "x-", "x+", "y-", "y+", or "z+", the top.
    order : str, optional
        "delivery": every part has a stop. The parts of each stop can go straight out through the
        door, one after another, while those of all later stops are in place.

    Raises
    ------
    ArgumentError
        If a number is out of bounds.
    WorkersError
        If the search can't have such workers.

    Notes
    -----
    With `clearance_z`, distances are measured after all lengths along z are multiplied by
    `clearance / clearance_z`, and must be at least the clearance then. A clearance of a part is
    stretched in the same way.

    Examples
    --------
    >>> from packit_sim import PackSettings
    >>> settings = PackSettings(clearance=1.0, wall_clearance=2.0, unit="mm", removable=True)
    >>> settings.clearance
    1.0
    >>> PackSettings(clearance=-1.0)
    Traceback (most recent call last):
        ...
    packit_sim.core.errors.ArgumentError: clearance -1.0 is not possible: 0 to 1e+30
    """

    clearance: float = 0.0
    wall_clearance: float | WallClearance = 0.0
    accuracy: float | None = None
    boxes: int | None = None
    unit: Unit | None = None
    reading: ReadSettings = field(default_factory=ReadSettings)
    removable: bool = False
    insertable: bool = False
    stable: float | None = None
    keep_out: Sequence[Part | Path | str] = ()
    fixed: Sequence[Part | Path | str] = ()
    constraints: Sequence[CustomConstraint] = ()
    workers: int = 0
    backend: SearchBackend = "threads"
    address: str | None = None
    iterations: int | None = None
    stop: threading.Event | None = None
    separable: bool = False
    limits: Limits | Mapping[str, Limits] = NO_LIMITS
    clearance_z: float | None = None
    groups: Sequence[str] = ()
    powder: Powder | None = None
    even: bool = False
    door: Door = "z+"
    order: LoadingOrder | None = None

    def __post_init__(self) -> None:
        with about("clearance"):
            check_range("clearance", self.clearance, DISTANCES)
        with about("clearance_z"):
            stretch(self.clearance, self.clearance_z)
        if not isinstance(self.wall_clearance, WallClearance):
            with about("wall_clearance"):
                check_range("wall clearance", self.wall_clearance, DISTANCES)
        for name in ("accuracy", "stable"):
            if getattr(self, name) is not None:
                with about(name):
                    check_range(name, getattr(self, name), LENGTHS)
        for name, valid in (("boxes", COUNTS), ("iterations", ITERATIONS)):
            value = getattr(self, name)
            if value is not None:
                check_range(name, as_integer(name, value), valid)
        if self.unit is not None:
            check_unit(self.unit)
        for rule in self.groups:
            known = f"choose from {', '.join(GROUP_RULES)}"
            with about("groups"):
                check_range("rule of groups", rule, (rule in GROUP_RULES, known))
        with about("door"):
            check_door(self.door)
        with about("order"):
            check_range("order", self.order, (self.order in (None, "delivery"), "choose delivery"))
        check_search_workers(self.workers, self.backend, self.address)
