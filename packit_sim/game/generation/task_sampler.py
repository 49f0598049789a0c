"""Tasks generated on the fly, without a dataset; all items of each fit into the box."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.packs import LibraryRef, Pack, Task
from packit_sim.game.datasets.provenance import Sampled
from packit_sim.game.generation.chromosomes import Chromosome
from packit_sim.game.generation.pack_creator import Recipe
from packit_sim.libraries.library import ShapeLibrary


@dataclass(frozen=True)
class TaskSampler:
    """Generates tasks: what the Pack Creator packs by a random chromosome (paper, section 3).

    Such packs are looser than evolved ones, and their tasks easier. A task takes about 15 ms for
    each item that is new to the process at its size.

    Parameters
    ----------
    library : ShapeLibrary
        The library of shapes, or one of its splits.
    settings : EvolutionSettings
        The settings; only pool, scales, size_range and cells have an effect.

    Examples
    --------
    >>> import numpy as np
    >>> from packit_sim import EvolutionSettings, PackItEnv, ShapeLibrary, TaskSampler
    >>> train = ShapeLibrary.open("everyday").split("train")
    >>> sampler = TaskSampler(train, EvolutionSettings(pool=10, cells=(60, 60, 60)))
    >>> task = sampler(np.random.default_rng(0))
    >>> task.cells, len(task.solution) == len(task.items)
    ((60, 60, 60), True)
    >>> env = PackItEnv(sampler, cells=(60, 60, 60))  # another task at each reset
    """

    library: ShapeLibrary
    settings: EvolutionSettings = field(default_factory=EvolutionSettings)

    def __call__(self, rng: np.random.Generator) -> Task:
        """Generate a task with at least one item, and its solution."""
        while True:
            recipe = Recipe.drawn(self.library, self.settings, rng)
            box = recipe.creator().pack(Chromosome.random(self.settings, rng))
            if box.placed:
                sampled = Sampled(size=recipe.size)
                return Pack.of(box, LibraryRef.of(self.library), sampled).task(self.library)
