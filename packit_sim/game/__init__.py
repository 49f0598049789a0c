"""The benchmark: packs, the game in which agents pack them again, and the results.

This package and `packit_sim.parts` do not import each other; both build on the other packages.
"""
