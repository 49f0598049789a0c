"""Generation of packs: chromosomes, the Pack Creator, evolution, densification, jobs, puzzles."""
