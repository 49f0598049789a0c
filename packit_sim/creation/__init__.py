"""How packs come to be: chromosomes, evolution, whole datasets, and their description."""
