"""Chips as seen from the bus: registers, sample clock, faults."""
