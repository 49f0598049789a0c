"""Agents that play PackIt: policies for its sub-tasks."""

from packit_agents.heuristics import (
    BLBF,
    Aligned,
    LargestFirst,
    RandomLocation,
    RandomRotation,
    RandomShape,
)

__all__ = [
    "BLBF",
    "Aligned",
    "LargestFirst",
    "RandomLocation",
    "RandomRotation",
    "RandomShape",
]
