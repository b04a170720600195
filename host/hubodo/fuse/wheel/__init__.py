"""Wheel odometry: an error-state Kalman filter for one or two wheel nodes."""
