"""While it happens: recorder, odometry, position, status."""
