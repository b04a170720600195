"""A wheel faster than its gyro can say, or accelerometers at their end: the way, the sigmas, the bits."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from generators.clipped_drives import CASES, clipped_drive
from generators.wheel_drives import WheelDrive
from hubodo.fuse.wheel.entries import LEVER_ARM_X, LEVER_ARM_Y, MISALIGNMENT_X, MISALIGNMENT_Y
from hubodo.fuse.wheel.filter import WheelFilter, WheelSample
from hubodo.fuse.wheel.preintegration import WindowBuilder
from hubodo.fuse.wheel.spin_search import SpinTracker, find_spin, rederotate_window
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.fuse.wheel.window import Window
from hubodo.recording import Table
from wheel_runs import BOTH, config, end_error, nees, pose_error, tables

SEED = 102
UNHEARD_OF = 20.0
"""Squared error of x, y, heading over their covariance: one honest drive in 6000 has more."""


def _windows(drive: WheelDrive, name: str, limit: float) -> list[Window]:
    table = tables(drive)[name]
    return WindowBuilder("left", 0.0, limit).add_many(table.t, table.gyro, table.accel)


@cache
def _clipped(name: str) -> WheelDrive:
    return clipped_drive(CASES[name], SEED)


@pytest.fixture(scope="module")
def fast() -> WheelDrive:
    return _clipped("20 m/s")


@pytest.mark.parametrize(
    ("name", "worst"),
    [("15 m/s", 2.0), ("20 m/s", 2.0), ("20 m/s, braked at 7 m/s²", 2.5), ("±4 g at 12 m/s", 2.5)],
)
@pytest.mark.parametrize("names", [("left",), BOTH], ids=["one wheel", "two wheels"])
def test_what_the_sensors_could_not_say_costs_little_and_is_in_the_sigmas(
    name: str, worst: float, names: tuple[str, ...]
) -> None:
    case = CASES[name]
    drive = _clipped(name)
    found = run_wheel_filter(config(drive, names, limits=case.limits), tables(drive))
    assert 100.0 * end_error(drive, found) / drive.length < worst, f"seed {SEED}"
    assert abs(found.report.distance / drive.length - 1.0) < 0.006
    assert nees(drive, found) < UNHEARD_OF


def test_without_a_limit_the_same_drive_is_far_off(fast: WheelDrive) -> None:
    found = run_wheel_filter(config(fast, ("left",), limits={"gyro_limit": 1e9}), tables(fast))
    assert abs(found.report.distance / fast.length - 1.0) > 0.2


def test_a_drive_that_begins_beyond_the_gyro_finds_its_spin() -> None:
    """Seed 304: without what angle and tilt make of a spin that is off, biases came out 13 sigma off."""
    case = CASES["20 m/s from the start"]
    drive = clipped_drive(case, 304)
    found = run_wheel_filter(config(drive, limits=case.limits), tables(drive))
    assert found.track.speed[5] == pytest.approx(20.0, abs=0.5)
    assert abs(found.report.distance / drive.length - 1.0) < 0.01
    assert nees(drive, found) < UNHEARD_OF


def test_what_gravity_was_looked_for_with_is_no_surer_for_that() -> None:
    """Else lever arms are 7 sigma off after 20 s beyond the gyro, biases follow: mean NEES 13 on these."""
    case, seeds = CASES["20 m/s from the start"], range(300, 304)
    drives = [clipped_drive(case, seed) for seed in seeds]
    found = [
        nees(drive, run_wheel_filter(config(drive, limits=case.limits), tables(drive))) for drive in drives
    ]
    print(seeds, np.round(found, 1))
    low, high = chi2.ppf([0.005, 0.995], 3 * len(found)) / len(found)
    assert low < np.mean(found) < high


@pytest.mark.parametrize("seed", [117, 118, 300, 302])
def test_a_drive_that_begins_beyond_the_gyro_knows_arm_and_tilt_after_a_second(seed: int) -> None:
    """What does not turn with the wheel shows them: some 50 m/s² on a lever arm, 2 rad/s let in by a tilt.

    Without it arms of centimetres came out 4 to 23 sigma off, and what they make of a curve was a heading:
    mean NEES 6.6 with one wheel and 5.0 with two over 24 drives.
    """
    case = CASES["20 m/s from the start"]
    drive = clipped_drive(case, seed)
    first = {name: _until(table, 1.6) for name, table in tables(drive).items()}
    made = run_wheel_filter(config(drive, limits=case.limits), first)
    found, squares = made.filter.core, []
    for wheel in found.wheels:
        truth = drive.nodes[wheel.name].truth
        for entry, key in (
            (LEVER_ARM_X, "arm_x"),
            (LEVER_ARM_Y, "arm_y"),
            (MISALIGNMENT_X, "tilt_x"),
            (MISALIGNMENT_Y, "tilt_y"),
        ):
            seen = found.estimate(wheel.name, entry)
            squares.append(((seen.value - truth[key]) / seen.sigma) ** 2)
            # 0.1 m and 0.03 rad: of the tilt a bias of 0.1 rad/s at 67 rad/s is left.
            assert seen.sigma < 0.1 * entry.prior, entry
    off = math.degrees(pose_error(drive, made.track, -1)[0][2])
    print(seed, np.round(squares, 1), off)
    assert max(squares) < 5.0**2
    assert abs(off) < 0.25


def _until(table: Table, end: float) -> Table:
    return Table({name: table[name][table.t < end] for name in ("t", "gx", "gy", "gz", "ax", "ay", "az")})


@pytest.mark.parametrize("seed", [109, 300])
def test_a_gyro_at_its_end_feels_no_less_than_that(seed: int) -> None:
    """Where braking ends just beyond 500 deg/s gravity turns by half a turn while it is looked at: a wheel
    that runs backwards fits as well. A gyro that stands at +8.7 rad/s does not: NEES 214 and 5159."""
    case = CASES["500 °/s at 4 m/s"]
    drive = clipped_drive(case, seed)
    found = run_wheel_filter(config(drive, ("left",), limits=case.limits), tables(drive))
    print(seed, nees(drive, found), end_error(drive, found) / drive.length)
    fast = found.track.t > 10.5
    fast &= found.track.t < 60.0
    assert found.track.speed[fast].min() > 0.5
    assert nees(drive, found) < UNHEARD_OF
    assert found.filter.core.wheels[0].angle_losses == 0


def test_a_wheel_that_is_heard_a_window_later_begins_with_the_spin_that_was_found() -> None:
    case = CASES["20 m/s from the start"]
    drive = clipped_drive(case, 103)
    begins = {_windows(drive, name, 34.8)[0].number for name in BOTH}
    assert len(begins) == 2, "seed 103: the nodes are not heard from the same window on"
    found = run_wheel_filter(config(drive, BOTH, limits=case.limits), tables(drive))
    assert 100.0 * end_error(drive, found) / drive.length < 2.0
    assert not any("gravity does not turn" in line for line in found.report.warnings)


def test_the_search_finds_spin_and_angle_of_the_truth(fast: WheelDrive) -> None:
    """At 33 s it rolls straight on at 20 m/s."""
    node = fast.nodes["left"]
    windows = [w for w in _windows(fast, "left", 34.8) if 370 <= w.number < 380]
    found = find_spin(windows, fast.radius)
    assert found is not None
    rate = 20.0 / (fast.radius * (1.0 + node.truth["radius"]))
    assert windows[0].spin / 0.1 + found.excess == pytest.approx(rate, abs=0.3)
    # Over the second between both ends the angle agrees with the spin.
    assert found.end_angle - found.start_angle == pytest.approx(rate, abs=0.3)


@pytest.mark.parametrize("off", [0.0, 60.0])
def test_a_spin_is_seen_where_gravity_turns_with_it_and_nowhere_else(fast: WheelDrive, off: float) -> None:
    """At 33 s, straight on at 20 m/s; off: rad/s that the follower begins with too much.

    One window alone tells nothing.
    """
    node = fast.nodes["left"]
    windows = [w for w in _windows(fast, "left", 34.8) if 370 <= w.number < 380]
    follower = SpinTracker(fast.radius)
    rate = 20.0 / (fast.radius * (1.0 + node.truth["radius"]))
    follower.initialise(rate - windows[0].spin / 0.1 + off, 0.0)
    seen = []
    for window in windows:
        follower.track_window(window, 0j, 0j)
        seen.append(follower.is_observed)
    assert not seen[0]
    assert seen[-1] == (off == 0.0)


def test_a_window_made_again_without_excess_is_the_same_window(fast: WheelDrive) -> None:
    """Whatever clips, sums over the samples are the integrals that were made on the way."""
    for window in _windows(fast, "left", 0.1):
        if window.samples is None or window.missing:
            continue
        again = rederotate_window(window, 0.0)
        for name in ("across", "carrier", "force", "rate_carrier"):
            assert abs(getattr(again, name) - getattr(window, name)) < 1e-9, (window.number, name)
        assert abs(again.lever - window.lever) < 1e-7


def test_an_excess_turns_a_window_as_a_faster_gyro_would(fast: WheelDrive) -> None:
    table = tables(fast)["left"]
    faster = table.gyro.copy()
    faster[:, 2] += 7.0
    plain = WindowBuilder("left", 0.0, 0.1).add_many(table.t, table.gyro, table.accel)
    turned = WindowBuilder("left", 0.0, 0.1).add_many(table.t, faster, table.accel)
    compared = 0
    for slow, fast_one in zip(plain, turned, strict=True):
        if slow.samples is not None:
            again, compared = rederotate_window(slow, 7.0), compared + 1
            assert abs(again.force - fast_one.force) < 1e-6
            assert abs(again.carrier - fast_one.carrier) < 1e-9
    assert compared > 300


def test_single_samples_give_the_bits_of_the_whole_log_where_it_clips(fast: WheelDrive) -> None:
    """Until 36 s: it is faster than the gyro from 28 s on."""
    drive, limits = fast, CASES["20 m/s"].limits
    begun = {name: _until(table, 36.0) for name, table in tables(drive).items()}
    assert all(np.count_nonzero(np.abs(t.gyro[:, 2]) > limits["gyro_limit"]) > 500 for t in begun.values())
    whole = WheelFilter(config(drive, BOTH, limits=limits))
    columns = {name: (table.t, table.gyro, table.accel) for name, table in begun.items()}
    expected = [*whole.handle_many(columns).poses, *whole.finish().poses]
    single = WheelFilter(config(drive, BOTH, limits=limits))
    samples = [
        WheelSample(name, t, tuple(gyro), tuple(accel))
        for name, (times, gyros, accels) in columns.items()
        for t, gyro, accel in zip(times.tolist(), gyros.tolist(), accels.tolist(), strict=True)
    ]
    found = [pose for s in sorted(samples, key=lambda s: s.t) for pose in single.handle(s).poses]
    found += single.finish().poses
    assert [pose[:6] for pose in found] == [pose[:6] for pose in expected]
    assert np.array_equal(found[-1].covariance, expected[-1].covariance)
