"""PackIt-Sim: geometric planning by packing real 3D shapes into a box.

`__all__` is the public API, together with the public submodules that `docs/reference/api.md`
lists. Names are imported when they are first used, so that `import packit_sim` stays light.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium

from packit_sim.core.version import __version__

if TYPE_CHECKING:
    from packit_sim.box import Box as Box
    from packit_sim.core.errors import PackItError as PackItError
    from packit_sim.game.datasets.evolution_settings import EvolutionSettings as EvolutionSettings
    from packit_sim.game.datasets.original import read_original as read_original
    from packit_sim.game.datasets.pack_checks import verify as verify
    from packit_sim.game.datasets.pack_files import dataset_file as dataset_file
    from packit_sim.game.datasets.pack_files import load_tasks as load_tasks
    from packit_sim.game.datasets.pack_files import read_packs as read_packs
    from packit_sim.game.datasets.pack_files import write_packs as write_packs
    from packit_sim.game.datasets.packs import Pack as Pack
    from packit_sim.game.datasets.packs import Task as Task
    from packit_sim.game.envs.env import PackItEnv as PackItEnv
    from packit_sim.game.envs.vector import PackItVectorEnv as PackItVectorEnv
    from packit_sim.game.episodes.agents import Agent as Agent
    from packit_sim.game.episodes.episode import Episode as Episode
    from packit_sim.game.episodes.episode import Stage as Stage
    from packit_sim.game.evaluation.evaluation import Score as Score
    from packit_sim.game.evaluation.evaluation import compare as compare
    from packit_sim.game.evaluation.evaluation import evaluate as evaluate
    from packit_sim.game.evaluation.evaluation import evaluate_batched as evaluate_batched
    from packit_sim.game.evaluation.evaluation import play as play
    from packit_sim.game.evaluation.results import Rollout as Rollout
    from packit_sim.game.evaluation.results import read_results as read_results
    from packit_sim.game.evaluation.results import write_results as write_results
    from packit_sim.game.explorer.collection import PackCollection as PackCollection
    from packit_sim.game.explorer.explorer import Explorer as Explorer
    from packit_sim.game.generation.evolution import evolve as evolve
    from packit_sim.game.generation.puzzles import cut_puzzle as cut_puzzle
    from packit_sim.game.generation.sequences import SequenceSampler as SequenceSampler
    from packit_sim.geometry.shapes import Item as Item
    from packit_sim.geometry.shapes import Shape as Shape
    from packit_sim.libraries.library import ShapeLibrary as ShapeLibrary
    from packit_sim.parts.filling.task import PackSettings as PackSettings
    from packit_sim.parts.nesting.nest import NestSettings as NestSettings
    from packit_sim.parts.nesting.nest import nest as nest
    from packit_sim.parts.pack import pack as pack
    from packit_sim.parts.packings.containers import BoxContainer as BoxContainer
    from packit_sim.parts.packings.item_types import ItemType as ItemType
    from packit_sim.parts.packings.packing import Packing as Packing
    from packit_sim.parts.reading.box_types import BoxType as BoxType
    from packit_sim.parts.reading.part import Part as Part
    from packit_sim.parts.results.packed import PackedParts as PackedParts
    from packit_sim.physics.convex.settings import DecompositionSettings as DecompositionSettings
    from packit_sim.physics.quality import pack_quality as pack_quality
    from packit_sim.physics.settings import PhysicsSettings as PhysicsSettings
    from packit_sim.physics.settling import settle as settle
    from packit_sim.render.cameras import TOP as TOP
    from packit_sim.render.coloring import ByNumber as ByNumber
    from packit_sim.render.coloring import by_order as by_order
    from packit_sim.render.layouts import Layout as Layout
    from packit_sim.render.looks import Cut as Cut
    from packit_sim.render.looks import Look as Look
    from packit_sim.rules import Rules as Rules
    from packit_sim.scene import Scene as Scene

_HOMES = {
    "box": ("Box",),
    "core.errors": ("PackItError",),
    "game.datasets.evolution_settings": ("EvolutionSettings",),
    "game.datasets.original": ("read_original",),
    "game.datasets.pack_checks": ("verify",),
    "game.datasets.pack_files": ("dataset_file", "load_tasks", "read_packs", "write_packs"),
    "game.datasets.packs": ("Pack", "Task"),
    "game.envs.env": ("PackItEnv",),
    "game.envs.vector": ("PackItVectorEnv",),
    "game.evaluation.evaluation": ("Score", "compare", "evaluate", "evaluate_batched", "play"),
    "game.evaluation.results": ("Rollout", "read_results", "write_results"),
    "game.explorer.collection": ("PackCollection",),
    "game.explorer.explorer": ("Explorer",),
    "game.episodes.agents": ("Agent",),
    "game.episodes.episode": ("Episode", "Stage"),
    "game.generation.evolution": ("evolve",),
    "game.generation.puzzles": ("cut_puzzle",),
    "game.generation.sequences": ("SequenceSampler",),
    "geometry.shapes": ("Item", "Shape"),
    "libraries.library": ("ShapeLibrary",),
    "parts.packings.containers": ("BoxContainer",),
    "parts.packings.item_types": ("ItemType",),
    "parts.nesting.nest": ("NestSettings", "nest"),
    "parts.packings.packing": ("Packing",),
    "parts.reading.box_types": ("BoxType",),
    "parts.pack": ("pack",),
    "parts.results.packed": ("PackedParts",),
    "parts.reading.part": ("Part",),
    "parts.filling.task": ("PackSettings",),
    "physics.quality": ("pack_quality",),
    "physics.convex.settings": ("DecompositionSettings",),
    "physics.settings": ("PhysicsSettings",),
    "physics.settling": ("settle",),
    "render.cameras": ("TOP",),
    "render.coloring": ("ByNumber", "by_order"),
    "render.layouts": ("Layout",),
    "render.looks": ("Cut", "Look"),
    "rules": ("Rules",),
    "scene": ("Scene",),
}
"""The modules of the public names, below `packit_sim`; the same as above."""

_HOME_OF = {name: f"{__name__}.{home}" for home, names in _HOMES.items() for name in names}

__all__ = [*sorted(_HOME_OF), "__version__"]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module(_HOME_OF[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


for _id, _settings in (
    ("PackIt-v0", {}),
    ("PackItEasy-v0", {"easy": True}),
    ("PackItPhysics-v0", {"physics": True}),
):
    gymnasium.register(
        _id,
        entry_point="packit_sim.game.envs.env:PackItEnv",
        vector_entry_point="packit_sim.game.envs.vector:PackItVectorEnv",
        kwargs=_settings,
    )
