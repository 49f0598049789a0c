"""Agents that play PackIt: policies for its sub-tasks."""

from packit_agents.heuristics.locations import (
    BLBF,
    DBLF,
    HeightmapMinimisation,
    LeastEmpty,
    MaximalContact,
    RandomLocation,
)
from packit_agents.heuristics.rotations import Aligned, FirstFit, Lowest, RandomRotation
from packit_agents.heuristics.shapes import (
    LargestBoxFirst,
    LargestFirst,
    LargestFittingFirst,
    LongestFirst,
    RandomShape,
    SmallestFirst,
)

__all__ = [
    "BLBF",
    "DBLF",
    "Aligned",
    "FirstFit",
    "HeightmapMinimisation",
    "LargestBoxFirst",
    "LargestFirst",
    "LargestFittingFirst",
    "LeastEmpty",
    "LongestFirst",
    "Lowest",
    "MaximalContact",
    "RandomLocation",
    "RandomRotation",
    "RandomShape",
    "SmallestFirst",
]
