"""Sensor characterisation: Allan deviation, warm-up, calibration of both triads, north finding, heading."""
