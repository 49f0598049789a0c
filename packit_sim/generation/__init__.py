"""How packs are generated: chromosomes, the Pack Creator, evolution, generation jobs."""
