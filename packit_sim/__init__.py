"""PackIt-Sim: geometric planning by packing real 3D shapes into a box."""

import gymnasium

from packit_sim._version import __version__
from packit_sim.box import Box
from packit_sim.evaluation import evaluate, play
from packit_sim.evolution import EvolutionSettings, evolve
from packit_sim.library import ShapeLibrary
from packit_sim.packs import Pack, Task, read_packs, verify, write_packs
from packit_sim.policies import Agent
from packit_sim.shapes import Item, Shape

gymnasium.register("PackIt-v0", entry_point="packit_sim.env:PackItEnv")
gymnasium.register("PackItEasy-v0", entry_point="packit_sim.env:PackItEnv", kwargs={"easy": True})

__all__ = [
    "Agent",
    "Box",
    "EvolutionSettings",
    "Item",
    "Pack",
    "Shape",
    "ShapeLibrary",
    "Task",
    "__version__",
    "evaluate",
    "evolve",
    "play",
    "read_packs",
    "verify",
    "write_packs",
]
