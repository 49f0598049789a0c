"""The robot cell: table, open box, station, and an arm with a suction gripper."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from packit_sim.core.checks import POSITIVE, Range, check_settings
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.arrays import Floats
from packit_sim.geometry.items import PosedItem
from packit_sim.geometry.lattice import CELL
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.physics.settings import PhysicsSettings

GRAVITY = 9.81
"""Acceleration, m/s2."""

COLLAPSE_DISTANCE = 0.02 / 0.30
"""Box units by which a placed item moves in a collapse: 2 cm in a box of 0.30 m."""

COLLAPSE_ANGLE = 15.0
"""Degrees by which a placed item turns in a collapse."""

INSIDE = 0.005
"""Metres by which an item in the box may protrude from it at the end."""

STATION_SIDE = 0.15
"""Metres from the outside of the wall to the middle of the station, and twice that for the longest
item."""

TUBE = 0.005
"""Side of the square tube that carries a cup, m: its corners are inside the smallest cup."""

TILTED_TOOL = 0.10
"""Metres from the axis about which an arm tilts its tool at level 2 to the cup's face."""

PANDA = "panda"
"""The name of the arm with seven joints."""

PANDA_PAYLOAD = 2.8
"""Mass in kg that the panda lifts in addition to its tool."""

STANCE = 0.53
"""Metres from the axis of the panda's base to the middles of the box and of the station."""

WALL = 0.25
"""Thickness of the simulated walls, in box units."""


Cells = tuple[int | float, int | float, int | float]
"""The cells of a box along x, y and z, hundredths of a box unit; whole ones in the game."""


@dataclass(frozen=True)
class SuctionGripper:
    """A suction gripper that takes the largest of its cups that finds a place to hold an item.

    Parameters
    ----------
    cups : tuple of float
        Radii of the cups, m.
    pressure : float
        Vacuum in a cup, Pa.
    compliance : float
        Height by which the surface under a bellows cup may differ from a plane, m.
    tilt : float
        Largest angle between that plane and the horizontal, degrees.
    safety : float
        Ratio of the force with which a cup holds to the weight that it may lift.

    Raises
    ------
    ArgumentError
        If a setting is out of range.

    Examples
    --------
    >>> from packit_sim import SuctionGripper
    >>> gripper = SuctionGripper(cups=(0.01,))
    >>> round(gripper.force(0.01), 1)  # N
    18.8
    >>> round(gripper.payload(0.01), 2)  # kg
    0.96
    """

    cups: tuple[float, ...] = (0.004, 0.006, 0.010, 0.016)
    pressure: float = 60_000.0
    compliance: float = 0.002
    tilt: float = 20.0
    safety: float = 2.0

    def __post_init__(self) -> None:
        valid = len(self.cups) > 0 and all(0.001 <= radius <= 0.1 for radius in self.cups)
        check_settings(
            self,
            cups=(valid, "one radius or more from 0.001 to 0.1 m"),
            pressure=Range(0, 101_325, "(]"),
            compliance=Range(0.0, 0.02),
            tilt=Range(0.0, 45.0),
            safety=Range(1.0, 10.0),
        )

    def force(self, radius: float) -> float:
        """Return the force in N at which a cup of a radius in m lets go."""
        return self.pressure * math.pi * radius**2

    def payload(self, radius: float) -> float:
        """Return the largest mass in kg that a cup of a radius in m lifts."""
        return self.force(radius) / (self.safety * GRAVITY)


@dataclass(frozen=True)
class RobotCell:
    """The cell in which an arm packs the box, in SI units.

    The box's low corner is the origin; the table is at height 0, around it. Behind the box, towards
    larger y, is the station, where a fixture presents one item after the other. The panda stands on
    a pedestal next to the box, towards smaller x; behind the pedestal is its station.

    Parameters
    ----------
    arm : str
        "gantry", "panda", or the path of the URDF of a machine with the gantry's kinds of joints.
    edge : float
        Metres in a box unit.
    density : float
        Density of the items, kg/m3.
    friction : float
        Coulomb's coefficient of friction, between items and with the box.
    gripper : SuctionGripper
        The gripper.
    level : int
        1: an item is presented in the rotation of its placement, at a random yaw and position.
        2: in a random stable pose, so that it has to be turned in the air, by gantry or panda.
    reachable : bool
        Whether masks have only placements that the gripper can hold and that can be reached
        straight from above.
    moves : int
        Largest number of straight moves that insert an item: with 1 it comes straight down, with
        more also along x, y and z, where nothing else leads to the placement that was chosen.
    open_loop : bool
        Whether masks are computed among the planned poses, not among the actual ones.
    seed : int
        Seed of the random yaws and positions.
    speed : float
        Largest speed of an axis of the gantry, m/s, and of its wrist in rad/s divided by 4; of the
        panda's tool, whose joints also keep the limits of its URDF.
    acceleration : float
        Largest acceleration of the same.
    clearance : float
        Height above the rim at which items travel, and above the station, m.
    gap : float
        Height above its support at which an item is released, m.
    decomposition : DecompositionSettings
        The decomposition of shapes into convex pieces for the simulation.

    Raises
    ------
    ArgumentError
        If a setting is out of range.

    Examples
    --------
    >>> from packit_sim import RobotCell
    >>> cell = RobotCell(edge=0.4)
    >>> round(cell.gripper.payload(0.016), 2)  # kg
    2.46
    >>> RobotCell(level=3)
    Traceback (most recent call last):
        ...
    packit_sim.core.errors.ArgumentError: level 3 is not possible: 1 or 2
    """

    arm: str = "gantry"
    edge: float = 0.30
    density: float = 200.0
    friction: float = 0.5
    gripper: SuctionGripper = field(default_factory=SuctionGripper)
    level: int = 1
    reachable: bool = True
    moves: int = 1
    open_loop: bool = False
    seed: int = 0
    speed: float = 1.0
    acceleration: float = 4.0
    clearance: float = 0.02
    gap: float = 0.0005
    decomposition: DecompositionSettings = field(default_factory=DecompositionSettings)

    def __post_init__(self) -> None:
        check_settings(
            self,
            edge=Range(0.01, 10.0),
            density=Range(1.0, 30_000.0),
            friction=Range(0.0, 10.0),
            level=(self.level in (1, 2), "1 or 2"),
            moves=Range(1, 4),
            seed=Range(0, 2**63 - 1),
            speed=POSITIVE,
            acceleration=POSITIVE,
            clearance=Range(0.001, 1.0),
            gap=Range(0.0001, 0.02),
        )
        if self.level == 2 and self.arm not in ("gantry", PANDA):
            raise ArgumentError(
                f"level 2 is not possible for arm {self.arm!r}: only gantry and panda turn items "
                "in the air"
            )

    @property
    def world(self) -> PhysicsSettings:
        """The simulated world."""
        return PhysicsSettings(
            side=self.edge,
            density=self.density,
            friction=self.friction,
            min_mass_ratio=0.0,
            decomposition=self.decomposition,
        )

    @property
    def joints(self) -> int:
        """The number of the arm's joints."""
        return (6 if self.arm == PANDA else 3) + self.level

    def size(self, cells: Cells) -> Floats:
        """Return the inner extents (3,) of a box in m."""
        return np.array(cells) * (CELL * self.edge)

    def mass(self, volume: float) -> float:
        """Return the mass in kg of an item of a volume in cubic box units."""
        return volume * self.edge**3 * self.density

    def station(self, cells: Cells) -> Floats:
        """Return the middle (3,) of the station for a box, in m."""
        if self.arm == PANDA:
            x, y = self.foot(cells)
            return np.array((x, y + STANCE, 0.0))
        x, y, _ = self.size(cells)
        longest = 0.5 * float(max(self.size(cells)))
        if self.level == 2:
            longest += TILTED_TOOL  # the tool comes from all sides
        return np.array((x / 2, y + WALL * self.edge + STATION_SIDE + longest, 0.0))

    def foot(self, cells: Cells) -> tuple[float, float]:
        """Return where the panda's pedestal stands on the table, in m."""
        x, y, _ = (self.size(cells) / 2).tolist()
        return x - STANCE, y

    def holds(self, cells: Cells, posed: PosedItem) -> bool:
        """Decide whether an item is wholly inside a box, below its rim (see `INSIDE`)."""
        slack = INSIDE / self.edge
        low, high = posed.bounds
        return bool((low >= -slack).all() and (high <= np.array(cells) * CELL + slack).all())

    def check_payload(self, name: str, volume: float) -> None:
        """Raise ArgumentError if an item of a volume in cubic box units is too heavy."""
        limits = {"the largest cup": self.gripper.payload(max(self.gripper.cups))}
        if self.arm == PANDA:
            limits[f"arm {PANDA!r}"] = PANDA_PAYLOAD
        mass = self.mass(volume)
        for what, most in limits.items():
            if mass > most:
                raise ArgumentError(
                    f"{name} weighs {mass:.3g} kg: {what} lifts at most {most:.3g} kg"
                )


def walls(cells: Cells) -> dict[str, tuple[Floats, Floats]]:
    """Return the lowest and the highest corner, (3,), of each wall of a box, in box units."""
    x, y, z = np.array(cells) * CELL
    return {
        "left": (np.array((-WALL, -WALL, 0.0)), np.array((0.0, y + WALL, z))),
        "right": (np.array((x, -WALL, 0.0)), np.array((x + WALL, y + WALL, z))),
        "back": (np.array((0.0, -WALL, 0.0)), np.array((x, 0.0, z))),
        "front": (np.array((0.0, y, 0.0)), np.array((x, y + WALL, z))),
    }
