"""Runs on one page that opens anywhere: tables, plots, and a gallery of boxes to be turned."""
