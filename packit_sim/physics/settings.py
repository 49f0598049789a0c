"""Settings of the simulated world and of the decomposition into convex pieces."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

from packit_sim.core.checks import Range, check_settings
from packit_sim.core.errors import ArgumentError

Method = Literal["coacd", "bisection"]

METHODS: tuple[Method, ...] = get_args(Method)

INSIDE = 0.005
"""Box units by which an item inside the box may protrude from it: contacts are slightly soft, and
pieces are smaller than the mesh by about as much."""

DISTANCE = 0.05
"""Box units by which no point of a stable item moves. Items are placed on grid nodes, so that there
may be a gap of up to a grid step, 0.04, below them: a drop of that height is no instability. A
corner 0.5 away from the edge over which an item tilts moves this far at 6 degrees."""


@dataclass(frozen=True)
class DecompositionSettings:
    """Settings of the decomposition of shapes into convex pieces.

    Parameters
    ----------
    method : {"coacd", "bisection"}
        Bisection needs no extra package and takes about a second, but its pieces are more and
        worse.
    threshold : float
        CoACD's concavity threshold, 0.01 to 1: how hollow a piece may be.
    preprocess_resolution : int
        CoACD's resolution of the remeshed surface, 20 to 100.
    mcts_iterations : int
        Iterations of CoACD's tree search, 20 to 2000.
    mcts_nodes : int
        Child nodes in CoACD's tree search, 10 to 40.
    mcts_max_depth : int
        Depth of CoACD's tree search, 2 to 7.
    seed : int
        CoACD's random seed.
    seconds : int
        Limit of CoACD's CPU time for a shape; after it the shape is bisected.
    hausdorff : float
        Bisection divides pieces with a larger one-sided Hausdorff distance from the shape, in
        canonical units.
    max_pieces : int
        Largest number of pieces of a bisection.

    Raises
    ------
    ArgumentError
        If a setting is out of range.
    """

    method: Method = "coacd"
    threshold: float = 0.05
    preprocess_resolution: int = 30
    mcts_iterations: int = 20
    mcts_nodes: int = 10
    mcts_max_depth: int = 2
    seed: int = 0
    seconds: int = 120
    hausdorff: float = 0.01
    max_pieces: int = 64

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            choices = ", ".join(METHODS)
            raise ArgumentError(f"method {self.method!r} is not known: choose from {choices}")
        check_settings(
            self,
            threshold=Range(0.01, 1.0),
            preprocess_resolution=Range(20, 100),
            mcts_iterations=Range(20, 2000),
            mcts_nodes=Range(10, 40),
            mcts_max_depth=Range(2, 7),
            seconds=Range(1, 10**6),
            hausdorff=Range(0.001, 1.0),
            max_pieces=Range(1, 1000),
        )


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
