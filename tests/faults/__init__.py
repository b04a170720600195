"""Faults, what is to happen, and the counter that moves."""
