"""Tasks made on the fly: no dataset, no two alike, and yet each can be packed whole."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from packit_sim.datasets.evolution_settings import EvolutionSettings
from packit_sim.datasets.packs import LibraryRef, Pack, Task
from packit_sim.datasets.provenance import Sampled
from packit_sim.generation.chromosomes import Chromosome
from packit_sim.generation.pack_creator import Recipe
from packit_sim.libraries.library import ShapeLibrary


@dataclass(frozen=True)
class TaskSampler:
    """Makes tasks: what the Pack Creator gets into a box by a random chromosome (paper, section 3).

    Such packs are looser than evolved ones, and their tasks easier. settings: pool, scales,
    size_range and cells count, the rest is about evolution. A task costs what its items do that the
    process has not seen at their size yet, some 15 ms each.
    """

    library: ShapeLibrary
    settings: EvolutionSettings = field(default_factory=EvolutionSettings)

    def __call__(self, rng: np.random.Generator) -> Task:
        """The next task that the generator's numbers lead to; never one without items."""
        while True:
            recipe = Recipe.drawn(self.library, self.settings, rng)
            box = recipe.creator().pack(Chromosome.random(self.settings, rng))
            if box.placed:
                sampled = Sampled(size=recipe.size)
                return Pack.of(box, LibraryRef.of(self.library), sampled).task(self.library)
