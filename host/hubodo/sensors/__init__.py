"""What a sensor is worth: Allan deviation, warm-up, calibration of both triads, and north."""
