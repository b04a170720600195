"""Live recording: recorder, odometry, map position, status."""
