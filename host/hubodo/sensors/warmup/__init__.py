"""Warm-up drift of the gyro bias: fit, whiteness tests, forecast and bias filters."""
