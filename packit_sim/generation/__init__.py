"""Generation of packs: chromosomes, the Pack Creator, evolution, generation jobs."""
