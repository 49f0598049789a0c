"""Policies that follow a rule, for shapes, rotations and locations, and what they measure."""
