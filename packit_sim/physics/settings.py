"""Settings of physics: the simulated world, and how shapes become convex pieces for it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

from packit_sim.core.errors import ArgumentError

Method = Literal["coacd", "bisection"]

METHODS: tuple[Method, ...] = get_args(Method)

INSIDE = 0.005
"""Box units by which an item may reach out of the box and still be inside: a contact gives way a
little, and pieces fall short of the mesh by about as much."""

DISTANCE = 0.05
"""Box units by which no point of a stable item moves. Items are placed on grid nodes, so that one
may be up to a grid step, 0.04, above what supports it: dropping by that much is no instability. A
corner 0.5 from the edge over which an item tilts moves this far at 6 degrees."""


@dataclass(frozen=True)
class DecompositionSettings:
    """How shapes become convex pieces.

    method: "coacd", or "bisection", which needs no extra, takes about a second, and ends in more
    pieces that are worse. threshold, preprocess_resolution, mcts_iterations, mcts_nodes,
    mcts_max_depth, seed: CoACD's own, of which the first is how hollow a piece may be, 0.01 to 1.
    seconds: of a processor that CoACD may take for a shape, before halving does it. overhang: how
    far halving lets a piece reach out of the shape, in canonical units, and most: pieces that it
    may make. Raises ValueError where one is out of range.
    """

    method: Method = "coacd"
    threshold: float = 0.05
    preprocess_resolution: int = 30
    mcts_iterations: int = 20
    mcts_nodes: int = 10
    mcts_max_depth: int = 2
    seed: int = 0
    seconds: int = 120
    overhang: float = 0.01
    most: int = 64

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            choices = ", ".join(METHODS)
            raise ArgumentError(f"method {self.method!r} is not known: choose from {choices}")
        for name, low, high in (
            ("threshold", 0.01, 1.0),
            ("preprocess_resolution", 20, 100),
            ("mcts_iterations", 20, 2000),
            ("mcts_nodes", 10, 40),
            ("mcts_max_depth", 2, 7),
            ("seconds", 1, 10**6),
            ("overhang", 0.001, 1.0),
            ("most", 1, 1000),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ArgumentError(f"{name} {value!r} is not possible: {low} to {high}")


@dataclass(frozen=True)
class PhysicsSettings:
    """The world in which items move, and when it ends. SI units, but for `side`.

    side: metres of a box unit. density: kg/m3 of every item, whose mass is that times its
    volume. lightest: the share of the heaviest item's mass that none in its box is taken to
    fall short of; 0 takes them as they are, but a solver presses what is very light through
    walls, where something very heavy lies on it. gravity: m/s2. friction: Coulomb's
    coefficient, between items as with walls. rolling: the arm of rolling resistance, in metres,
    without which no ball would ever rest. restitution: the share of speed that comes back from
    an impact. damping: the share of all speed that is lost in a second. step: seconds of a step
    of time. limit: seconds after which it ends in any case. rest: m/s below which each point of
    every item stays for `calm` seconds, where all are at rest. decomposition: how shapes become
    convex pieces. fitted: whether pieces are cut back where they reach into others' at the
    start (see `fitting`). Raises ValueError where one is out of range.
    """

    side: float = 0.5
    density: float = 500.0
    lightest: float = 0.01
    gravity: float = 9.81
    friction: float = 0.5
    rolling: float = 0.001
    restitution: float = 0.1
    damping: float = 0.04
    step: float = 1 / 240
    limit: float = 5.0
    rest: float = 0.02
    calm: float = 0.25
    decomposition: DecompositionSettings = field(default_factory=DecompositionSettings)
    fitted: bool = True

    def __post_init__(self) -> None:
        for name, low, high in (
            ("side", 1e-3, 1e3),
            ("density", 1e-3, 1e6),
            ("lightest", 0.0, 1.0),
            ("gravity", 0.0, 1e3),
            ("friction", 0.0, 10.0),
            ("rolling", 0.0, 1.0),
            ("restitution", 0.0, 1.0),
            ("damping", 0.0, 1.0),
            ("step", 1e-5, 0.02),
            ("limit", 0.0, 3600.0),
            ("rest", 0.0, 10.0),
            ("calm", 0.0, 60.0),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ArgumentError(f"{name} {value!r} is not possible: {low:g} to {high:g}")
