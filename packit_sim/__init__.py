"""PackIt-Sim: geometric planning by packing real 3D shapes into a box."""

import gymnasium

from packit_sim._version import __version__
from packit_sim.box import Box
from packit_sim.datasets.packs import Pack, Task, read_packs, verify, write_packs
from packit_sim.evaluation.evaluation import evaluate, play
from packit_sim.game.agents import Agent
from packit_sim.generation.chromosomes import EvolutionSettings
from packit_sim.generation.evolution import evolve
from packit_sim.geometry.shapes import Item, Shape
from packit_sim.libraries.library import ShapeLibrary

for _id, _settings in (
    ("PackIt-v0", {}),
    ("PackItEasy-v0", {"easy": True}),
    ("PackItPhysics-v0", {"physics": True}),
):
    gymnasium.register(
        _id,
        entry_point="packit_sim.envs.env:PackItEnv",
        vector_entry_point="packit_sim.envs.vector:PackItVectorEnv",
        kwargs=_settings,
    )

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
