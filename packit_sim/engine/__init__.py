"""The exact placement engine: placed items, occupancy, collision, feasible locations, sweeps."""
