"""Shared by every other package: errors, files, caches, compilation, statistics, workers."""
