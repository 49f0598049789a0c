"""What every other package shares: errors, files, caches, compilation, counters, workers."""
