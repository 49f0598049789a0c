"""Agents on many tasks: results, their means and intervals, and the paper's tables and figure."""
