"""Estimators that turn measurements into states, without ports, files, clocks or threads."""
