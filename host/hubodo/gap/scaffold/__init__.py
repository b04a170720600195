"""Scaffolding of a new effect from the dependence that explains a residual best."""
