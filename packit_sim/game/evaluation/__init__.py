"""The evaluation of agents on tasks: results, scores, comparisons."""
