"""Calibration of wheels, track width and nodes from a drive with known positions."""
