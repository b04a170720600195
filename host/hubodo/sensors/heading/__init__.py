"""Heading from one gyro axis."""
