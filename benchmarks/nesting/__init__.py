"""The benchmark of `packit_sim.nest`; see `__main__`."""
