"""Settings of the decomposition into convex pieces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from packit_sim.core.checks import Range, check_settings
from packit_sim.core.errors import ArgumentError

Method = Literal["coacd", "bisection"]

METHODS: tuple[Method, ...] = get_args(Method)


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

    Examples
    --------
    >>> from packit_sim import DecompositionSettings, PhysicsSettings
    >>> quick = DecompositionSettings(method="bisection", max_pieces=16)
    >>> PhysicsSettings(decomposition=quick).decomposition.max_pieces
    16
    >>> DecompositionSettings(method="voxels")
    Traceback (most recent call last):
        ...
    packit_sim.core.errors.ArgumentError: method 'voxels' is not known: choose from coacd, bisection
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
