"""Filters of one gyro axis, and their comparison on a log."""
