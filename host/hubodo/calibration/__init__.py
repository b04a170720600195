"""The calibration file: reading, writing, application to samples, conversion to model effects."""
