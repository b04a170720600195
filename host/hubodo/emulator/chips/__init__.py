"""Emulated chips: registers, sample clock and faults."""
