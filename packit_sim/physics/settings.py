"""Settings of the simulated world, and the thresholds of stability."""

from __future__ import annotations

from dataclasses import dataclass, field

from packit_sim.core.checks import Range, check_settings
from packit_sim.physics.convex.settings import DecompositionSettings

INSIDE = 0.005
"""Box units by which an item inside the box may protrude from it: contacts are slightly soft, and
pieces are smaller than the mesh by about as much."""

DISTANCE = 0.05
"""Box units by which no point of a stable item moves. Items are placed on grid nodes, so that there
may be a gap of up to a grid step, 0.04, below them: a drop of that height is no instability. A
corner 0.5 away from the edge over which an item tilts moves this far at 6 degrees."""


@dataclass(frozen=True)
class PhysicsSettings:
    """The simulated world, and when a simulation ends; in SI units, except for `side`.

    Parameters
    ----------
    side : float
        Metres in a box unit.
    density : float
        Density of all items, kg/m3. An item's mass is its density times its volume.
    min_mass_ratio : float
        Minimum mass of an item, relative to the heaviest item in the box; 0 for no minimum. The
        solver would press very light items through walls if very heavy ones lie on them.
    gravity : float
        Acceleration, m/s2.
    friction : float
        Coulomb's coefficient of friction, between items and with walls.
    rolling : float
        Arm of the rolling resistance, m; with 0 no ball would ever come to rest.
    restitution : float
        Share of the speed that remains after an impact.
    damping : float
        Share of the speed that is lost in a second.
    step : float
        Time step, s.
    time_limit : float
        Simulated time after which a simulation ends, s.
    rest_speed : float
        Items are at rest if no point of them moves faster, m/s, for `rest_time`.
    rest_time : float
        Time for which items stay below `rest_speed` before a simulation ends, s.
    decomposition : DecompositionSettings
        The decomposition of shapes into convex pieces.
    fitted : bool
        Whether pieces that overlap those of other items at the start are cut (see `fitting`).

    Raises
    ------
    ArgumentError
        If a setting is out of range.

    Examples
    --------
    >>> from packit_sim import PhysicsSettings, Rules
    >>> moon = PhysicsSettings(gravity=1.62)
    >>> print(Rules(physics=moon))
    PackIt, physics gravity=1.62
    >>> PhysicsSettings(friction=-1)
    Traceback (most recent call last):
        ...
    packit_sim.core.errors.ArgumentError: friction -1 is not possible: 0 to 10
    """

    side: float = 0.5
    density: float = 500.0
    min_mass_ratio: float = 0.01
    gravity: float = 9.81
    friction: float = 0.5
    rolling: float = 0.001
    restitution: float = 0.1
    damping: float = 0.04
    step: float = 1 / 240
    time_limit: float = 5.0
    rest_speed: float = 0.02
    rest_time: float = 0.25
    decomposition: DecompositionSettings = field(default_factory=DecompositionSettings)
    fitted: bool = True

    def __post_init__(self) -> None:
        check_settings(
            self,
            side=Range(1e-3, 1e3),
            density=Range(1e-3, 1e6),
            min_mass_ratio=Range(0.0, 1.0),
            gravity=Range(0.0, 1e3),
            friction=Range(0.0, 10.0),
            rolling=Range(0.0, 1.0),
            restitution=Range(0.0, 1.0),
            damping=Range(0.0, 1.0),
            step=Range(1e-5, 0.02),
            time_limit=Range(0.0, 3600.0),
            rest_speed=Range(0.0, 10.0),
            rest_time=Range(0.0, 60.0),
        )
