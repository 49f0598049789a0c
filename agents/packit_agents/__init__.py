"""Agents that play PackIt: policies for its sub-tasks."""

from packit_agents.heuristics.best_fit import BestFitLocation, BestFitRotation, BestFitShape
from packit_agents.heuristics.location_policies import (
    BLBF,
    DBLF,
    HeightmapMinimisation,
    LeastEmpty,
    MaximalContact,
    RandomLocation,
)
from packit_agents.heuristics.rotation_policies import Aligned, FirstFit, Lowest, RandomRotation
from packit_agents.heuristics.shape_policies import (
    LargestBoxFirst,
    LargestFirst,
    LargestFittingFirst,
    LongestFirst,
    OldestFirst,
    RandomShape,
    SmallestFirst,
)

__all__ = [
    "BLBF",
    "DBLF",
    "Aligned",
    "BestFitLocation",
    "BestFitRotation",
    "BestFitShape",
    "FirstFit",
    "HeightmapMinimisation",
    "LargestBoxFirst",
    "LargestFirst",
    "LargestFittingFirst",
    "LeastEmpty",
    "LongestFirst",
    "Lowest",
    "MaximalContact",
    "OldestFirst",
    "RandomLocation",
    "RandomRotation",
    "RandomShape",
    "SmallestFirst",
]
