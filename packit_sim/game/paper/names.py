"""The names of what is reproduced, as plain values."""

HEURISTIC = "largest-first/aligned/blbf"
"""The paper's agent."""

TABLE_NAMES = ("table1", "beam", "backtrack", "easy", "baselines")

EVOLUTION = "evolution"

PORTFOLIO = "portfolio"

QUICK_TASKS = 20
"""Tasks of the tables, for a first look."""

QUICK_EVOLUTIONS = 4

QUICK_SECONDS = 3.0
"""Processor seconds of each search of the portfolio on each task, for a first look."""
