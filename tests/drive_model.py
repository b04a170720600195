"""The model file of a wheelchair that a reference drives, for tests that only want one."""

DRIVE_MODEL = """[vehicle]
wheel_radius = 0.31
track_width = 0.92
[imu]
gyro_noise = 0.004
accel_noise = 0.05
[nodes.left]
side = "left"
facing = "left"
[nodes.right]
side = "right"
facing = "left"
[inputs]
speed = "reference.speed"
yaw_rate = "reference.yaw_rate"
"""
QUIET_INPUTS = "speed_noise = 0.0005\nyaw_rate_noise = 0.0002\n"
"""To be put behind it."""
