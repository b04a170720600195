"""Refit of the best candidates by Gauss-Newton."""
