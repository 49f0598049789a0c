"""Evaluations and trainings on one HTML page: tables, plots, and interactive boxes."""
