"""A second accelerometer of 200 g: what a rim gains by it, live as in bulk, and when it is not used."""

import cmath
from dataclasses import replace

import numpy as np
import pytest

from generators.rim_drives import IMU_RANGE, RimDrive, short_rim_drive
from generators.wheel_drives import GRAVITY
from hubodo.fuse.range_extension import MAX_DELAY, RangeExtension, extend_table
from hubodo.fuse.ranges import uncorrected_accel_limit
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.preintegration import BEYOND_RANGE, sample_block
from hubodo.fuse.wheel_odometry import compute_wheel_odometry
from hubodo.ingest.live.odometer import Odometer
from hubodo.ingest.replay.playback import Playback, to_messages
from hubodo.log.log_writer import LogWriter
from hubodo.log.records import HighGSamples, ImuBlock
from hubodo.log.timebase import to_ns, to_seconds
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, Vehicle
from wheel_runs import true_pose

Tables = dict[str, Table]
SEED = 43
LIMIT = uncorrected_accel_limit(IMU_RANGE)
ZERO_NS = 10**9
IMU_SAMPLES, CHIP_SAMPLES = 8, 16
"""Samples in a message."""


@pytest.fixture(scope="module")
def rim() -> RimDrive:
    """A drive to 14 m/s with nodes 0.15 m from the axle, both of whose axes across the axle saturate."""
    return short_rim_drive(SEED)


def vehicle_of(rim: RimDrive) -> Vehicle:
    mounts = {"left": NodeMount("left", "left", accel_range=IMU_RANGE)}
    return Vehicle(rim.drive.radius, rim.drive.track, mounts)


def end_error(rim: RimDrive, recording: Recording) -> float:
    """Return the error of the end of the left wheel's track, share of the path."""
    track = compute_wheel_odometry(recording, vehicle_of(rim), log="rim").track
    start, end = (true_pose(rim.drive, t) for t in (track.t[0], track.t[-1]))
    displacement = complex(*(end - start)[:2]) * cmath.exp(-1j * start[2])
    return abs(complex(track.x[-1], track.y[-1]) - displacement) / rim.drive.length


def test_a_rim_beyond_the_range_of_both_axes_gives_a_track_only_with_the_second_accelerometer(rim):
    assert end_error(rim, replace(rim.recording, high_g={})) > 0.03
    assert end_error(rim, rim.recording) < 0.01


def test_saturated_axes_are_replaced_within_noise_and_calibration_error(rim):
    table, chip = rim.recording.nodes["left"], rim.chips["left"]
    extended = extend_table(table, chip, LIMIT)
    replaced = extended[BEYOND_RANGE] > 0.0
    saturated = (np.abs(table.accel) >= LIMIT) & (table.t < chip.t[-1])[:, None]
    assert np.array_equal(replaced, saturated.any(axis=1))
    assert np.array_equal(extended.accel[~saturated], table.accel[~saturated])
    error = (extended.accel - rim.wide["left"])[saturated]
    # 5 mg/√Hz at 200 Hz, and steps of 49 mg.
    noise = GRAVITY * np.hypot(5e-3 * np.sqrt(200.0), 0.049 / np.sqrt(12.0))
    assert abs(np.mean(error)) < 0.5
    assert np.std(error) < 1.5 * noise


def rounded(table: Table) -> Table:
    """Return the rows at times that a log holds."""
    return Table({**table.columns, "t": to_seconds(to_ns(table.t, ZERO_NS), ZERO_NS)})


def received(nodes: Tables, chips: Tables) -> list[HighGSamples | ImuBlock]:
    """Return messages in the order of arrival; those of the second accelerometer are late by up to 0.25 s."""
    rng, messages = np.random.default_rng(SEED), []
    for name, table in nodes.items():
        t_ns = to_ns(table.t, ZERO_NS)
        for first in range(0, len(table), IMU_SAMPLES):
            rows = slice(first, first + IMU_SAMPLES)
            block = ImuBlock(name, table.gyro[rows], table.accel[rows], None, 0, t_ns=t_ns[rows])
            messages.append((t_ns[rows][-1], block))
        chip = chips[name]
        t_ns, arrival_ns = to_ns(chip.t, ZERO_NS), 0
        for first in range(0, len(chip), CHIP_SAMPLES):
            rows = slice(first, first + CHIP_SAMPLES)
            arrival_ns = max(arrival_ns, t_ns[rows][-1], t_ns[rows][0] + int(rng.uniform(0.0, 0.25e9)))
            messages.append((arrival_ns, HighGSamples(name, t_ns[rows], 0, chip.accel[rows])))
    arrived = sorted(messages, key=lambda message: message[0])
    return [replace(samples, t_log_ns=10**9 + 1000 * number) for number, (_, samples) in enumerate(arrived)]


def test_live_bulk_and_playback_are_equal_bit_by_bit(rim, tmp_path):
    nodes, chips = ({"left": rounded(part["left"])} for part in (rim.nodes, rim.chips))
    vehicle = vehicle_of(rim)
    live, rows, path = Odometer(vehicle, ZERO_NS), [], tmp_path / "rim.mcap"
    with LogWriter(path, t_zero_ns=ZERO_NS, clock=None) as log:
        for samples in received(nodes, chips):
            log.write_record(samples)
            rows += live.handle(samples)
    rows += live.finish()
    assert live._filter is not None
    bulk = WheelFilter(replace(live._filter.config, start_heading=0.0))
    extended = {name: extend_table(table, chips[name], LIMIT) for name, table in nodes.items()}
    assert all(np.count_nonzero(table[BEYOND_RANGE]) > 1000 for table in extended.values())
    poses = bulk.handle_blocks({name: sample_block(table) for name, table in extended.items()}).poses
    expected = [pose[:6] for pose in [*poses, *bulk.finish().poses]]
    assert [pose[:6] for pose in live.take_poses()] == expected
    assert to_messages(Playback(path, vehicle=vehicle).odometry_rows(), ZERO_NS) == to_messages(rows, ZERO_NS)


T = np.arange(0.0, 20.0, 1.0 / 416.0)
FORCE = np.column_stack([80.0 * np.sin(3.0 * T) + 8.0 * T, GRAVITY * np.cos(9.0 * T), 2.0 * np.sin(0.7 * T)])
"""m/s²; beyond 16 g at the crests from `SATURATED_S` on."""
SATURATED_S = float(T[np.argmax(np.abs(FORCE[:, 0]) >= LIMIT)])
COLUMNS = ("gx", "gy", "gz", "ax", "ay", "az")
RECORD = Table(
    {
        "t": T,
        **dict.fromkeys(COLUMNS[:3], np.zeros(len(T))),
        **dict(zip(COLUMNS[3:], np.clip(FORCE, -IMU_RANGE, IMU_RANGE).T, strict=True)),
    }
)


def chip_table(force: np.ndarray, chosen: np.ndarray | None = None) -> Table:
    chosen = np.ones(len(T), bool) if chosen is None else chosen
    return Table(dict(zip(("t", "ax", "ay", "az"), [T[chosen], *force[chosen].T], strict=True)))


@pytest.mark.parametrize(
    "chip",
    [chip_table(0.0 * FORCE), chip_table(FORCE + 3000.0), chip_table(FORCE, T > 19.5)],
    ids=["dead", "saturated itself", "switched on just now"],
)
def test_a_chip_that_cannot_be_calibrated_changes_nothing(chip):
    assert extend_table(RECORD, chip, LIMIT) is RECORD


def test_samples_in_an_outage_of_the_chip_and_just_after_it_stay_saturated():
    chip = chip_table(1.03 * FORCE + 4.0, (T < 17.0) | (T > 18.5))
    extended = extend_table(RECORD, chip, LIMIT)
    saturated, replaced = np.abs(RECORD["ax"]) >= LIMIT, extended[BEYOND_RANGE] > 0.0
    silent = (T > 17.0) & (T < 18.5 + MAX_DELAY)
    usable = (T > 12.0) & (T < 16.99) | (T > 18.51 + MAX_DELAY) & (T[-2] > T)
    assert min(np.count_nonzero(saturated & part) for part in (silent, usable)) > 100
    assert not replaced[silent].any()
    assert replaced[saturated & usable].all()


def test_an_idle_chip_does_not_fill_the_memory():
    extension = RangeExtension(LIMIT)
    for first in range(0, len(T), 8):
        rows = slice(first, first + 8)
        extension.add_chip(T[rows], 0.1 * FORCE[rows])
        extension.add_imu(T[rows], 0.1 * FORCE[rows])
        extension.learn()
    assert len(extension._imu_t) < 3 * 416
    assert len(extension._chip_t) < 5 * 416
