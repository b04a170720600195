"""Calibration of one gyro axis on a rate table."""
