"""Measurements of the factor graph: one file each, many measurements of a kind in one object."""
