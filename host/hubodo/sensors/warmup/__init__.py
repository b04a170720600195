"""The bias of a gyro that warms up."""
