"""Surface speeds of an encoder in the live odometry: equal to the fusion of a log, and consistent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from generators import wheel_drives
from generators.wheel_drives import WheelDrive
from hubodo.fuse.ranges import determine_ranges
from hubodo.fuse.wheel.config import wheel_config
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.records import Pose
from hubodo.fuse.wheel.surface_speeds import SurfaceSpeedAverager, SurfaceSpeeds, average_surface_speeds
from hubodo.ingest.live.odometer import Odometer, SpeedSample
from hubodo.recording import Table
from hubodo.vehicle import NodeMount, Vehicle
from set_pose_runs import drive_blocks

SEED = 21
VEHICLE = Vehicle(0.15, 0.5, {"left": NodeMount("left", "left")})
PLAN = [(2.0, 0.0, 0.0), (8.0, 1.2, 0.25), (8.0, 1.2, -0.3), (2.0, 0.0, 0.0)]


@pytest.fixture(scope="module")
def encoder_drive() -> tuple[WheelDrive, Table]:
    """A drive with one node at 104 Hz, and 50 Hz speeds of an encoder with a scale error of 1 % (1σ)."""
    rng = np.random.default_rng(SEED)
    drive = wheel_drives.drive(wheel_drives.legs(PLAN), rng, None, 0.15, 0.5, rate_hz=104.0)
    drive.nodes.pop("right")
    yaw_rate, every = np.gradient(drive.heading, drive.t), slice(None, None, 20)
    columns = {"t": drive.t[every]}
    for name, side in (("left", 1.0), ("right", -1.0)):
        speed = (1.0 + 0.01 * rng.standard_normal()) * (drive.speed - yaw_rate * side * 0.25)
        columns[name] = (speed + 0.01 * rng.standard_normal(len(drive.t)))[every]
    return drive, Table(columns)


def live_poses(drive: WheelDrive, wheels: Table | None, delay: float) -> list[Pose]:
    """Return the poses of the live odometry; rows of the encoder arrive `delay` s after their time."""
    odometer, poses = Odometer(VEHICLE, 0, encoder_aided=wheels is not None), []
    arrivals: list[tuple[float, object]] = [(block.t_ns[-1] * 1e-9, block) for block in drive_blocks(drive)]
    if wheels is not None:
        arrivals += [
            (t + delay, SpeedSample(round(t * 1e9), left, right))
            for t, left, right in zip(wheels.t, wheels["left"], wheels["right"], strict=True)
        ]
    for _, item in sorted(arrivals, key=lambda arrival: arrival[0]):
        if isinstance(item, SpeedSample):
            odometer.add_surface_speeds(item)
        else:
            odometer.handle(item)
        poses += odometer.take_poses()
    odometer.finish()
    return poses + odometer.take_poses()


def test_means_over_windows_equal_those_of_a_whole_table_with_gaps() -> None:
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.005, 0.3, 400))
    t = np.where(t > 5.0, t + 2.0, t)
    table = Table({"t": t, "left": np.sin(t), "right": rng.standard_normal(len(t))})
    averager = SurfaceSpeedAverager()
    means: SurfaceSpeeds = {}
    for row in zip(t, table["left"], table["right"], strict=True):
        means |= averager.add(*row)
    expected = average_surface_speeds(table)
    assert means.keys() == expected.keys() and len(means) > 500
    np.testing.assert_allclose(list(means.values()), list(expected.values()), atol=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.06])
def test_the_live_poses_equal_those_of_the_forward_filter_over_the_log(
    encoder_drive: tuple[WheelDrive, Table], delay: float
) -> None:
    drive, wheels = encoder_drive
    live = live_poses(drive, wheels, delay)
    ranges = {"left": determine_ranges(VEHICLE.nodes["left"], {}, corrected=False)}
    settings = replace(wheel_config(VEHICLE, ["left"], None, ranges), encoder_aided=True)
    node = drive.nodes["left"]
    wheel_filter = WheelFilter(settings, average_surface_speeds(wheels))
    bulk = [*wheel_filter.handle_blocks({"left": (node.t, node.gyro, node.accel)}).poses]
    bulk += wheel_filter.finish().poses
    # The last windows have no speeds yet when the live odometry ends.
    assert len(live) == len(bulk) > 190
    for ours, expected in zip(live[:-5], bulk, strict=False):
        assert ours[:6] == pytest.approx(expected[:6], abs=1e-6)
    unaided = live_poses(drive, None, 0.0)
    assert np.trace(live[-1].covariance[:2, :2]) < 0.7 * np.trace(unaided[-1].covariance[:2, :2])


def test_an_encoder_that_falls_silent_or_is_late_costs_no_pose(
    encoder_drive: tuple[WheelDrive, Table],
) -> None:
    drive, wheels = encoder_drive
    silent = Table({name: column[wheels.t < 8.0] for name, column in wheels.columns.items()})
    expected = len(live_poses(drive, None, 0.0))
    assert len(live_poses(drive, silent, 0.02)) == expected
    assert len(live_poses(drive, wheels, 0.7)) == expected
