"""A robot arm that packs a box in simulated physics: cell, grasps, motions, execution, measures."""
