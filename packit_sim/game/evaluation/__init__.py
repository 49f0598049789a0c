"""Agents play tasks: results, scores, comparisons."""
