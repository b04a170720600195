"""Drivers of chips: one file each, on the base class in chip.py."""
