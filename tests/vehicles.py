"""Vehicle and model files for tests."""

from __future__ import annotations

from collections.abc import Mapping

BOTH_LEFT: Mapping[str, str] = {"left": "left", "right": "left"}
"""Wheel nodes and where their z axes point."""
FROM_REFERENCE = 'speed = "reference.speed"\nyaw_rate = "reference.yaw_rate"\n'
"""Inputs of a model that is driven by a reference."""
LOW_INPUT_NOISE = "speed_noise = 0.0005\nyaw_rate_noise = 0.0002\n"


def vehicle_toml(
    wheel_radius: float = 0.31,
    track_width: float = 0.92,
    *,
    facing: Mapping[str, str] = BOTH_LEFT,
    more: str = "",
    imu: str = "",
    frame: bool = False,
) -> str:
    """Return a vehicle file (by default of a wheelchair) with a node on each wheel in `facing`.

    wheel_radius, track_width: m. more, imu: lines of [vehicle] and [imu]. frame: with a node on the frame.
    """
    nodes = "".join(
        f'[nodes.{side}]\nside = "{side}"\nfacing = "{where}"\n' for side, where in facing.items()
    )
    vehicle = f"[vehicle]\nwheel_radius = {wheel_radius}\ntrack_width = {track_width}\n{more}"
    return vehicle + (f"[imu]\n{imu}" if imu else "") + nodes + ("[nodes.frame]\n" if frame else "")


def model_toml(
    wheel_radius: float = 0.31,
    track_width: float = 0.92,
    *,
    gyro_noise: float = 0.004,
    accel_noise: float = 0.05,
    inputs: str = FROM_REFERENCE,
    facing: Mapping[str, str] = BOTH_LEFT,
    frame: bool = False,
) -> str:
    """Return a model file: a vehicle with IMU noise (rad/s and m/s² per sample) and the lines of [inputs]."""
    imu = f"gyro_noise = {gyro_noise}\naccel_noise = {accel_noise}\n"
    return (
        vehicle_toml(wheel_radius, track_width, facing=facing, imu=imu, frame=frame) + f"[inputs]\n{inputs}"
    )


DRIVE_MODEL = model_toml()
"""A wheelchair driven by a reference, for tests that need any model."""
