"""Agents that choose among placements: shape, rotation and location together."""
