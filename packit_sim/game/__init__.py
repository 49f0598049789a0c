"""The benchmark: packs, the game in which agents pack them again, and the results.

Nothing here knows `packit_sim.parts`, nor the other way: both stand on the same ground.
"""
