"""Policies that learn: PackNN, its training and its weights."""
