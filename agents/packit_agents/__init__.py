"""Agents that play PackIt: policies for its sub-tasks."""

from packit_agents.locations import (
    BLBF,
    DBLF,
    HeightmapMinimisation,
    LeastEmpty,
    MaximalContact,
    RandomLocation,
)
from packit_agents.rotations import Aligned, FirstFit, Lowest, RandomRotation
from packit_agents.shapes import (
    LargestBoxFirst,
    LargestFirst,
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
    "LeastEmpty",
    "LongestFirst",
    "Lowest",
    "MaximalContact",
    "RandomLocation",
    "RandomRotation",
    "RandomShape",
    "SmallestFirst",
]
