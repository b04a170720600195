"""Heading of a turntable or vehicle from one vertical gyro axis."""
