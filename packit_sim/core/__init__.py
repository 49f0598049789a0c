"""The base of all packages: errors, files, caches, compilation, counters, workers."""
