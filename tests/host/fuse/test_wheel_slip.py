"""Slip of wheels: detection of start and end, inertial speed meanwhile, reports to the user."""

from __future__ import annotations

import numpy as np
import pytest

import wanted
from accuracy import slip
from accuracy.slip import CASES, careless_outcome, count_real_alarms, make_drive, outcome
from generators import mixed_drives
from hubodo.fuse.wheel.config import wheel_config
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.preintegration import WheelSample
from hubodo.fuse.wheel.slip_detector import ForwardResidual, SlipDetector
from hubodo.fuse.wheel.state_vector import initial_state
from hubodo.fuse.wheel.track import run_wheel_filter, track_from_poses
from hubodo.ingest.live.odometer import Odometer
from hubodo.log.records import ImuBlock
from hubodo.vehicle import NodeMount, Vehicle
from repetitions import first_and_more
from wheel_runs import config, end_error, nees, tables, true_pose

LIFT = CASES["one wheel, lifted 6 s, runs out in 1 s"]


@pytest.fixture(scope="module")
def lifted_run():
    """Return drive, nodes, start of the lift and filter run of 120 m with the left wheel lifted for 6 s
    (seed 102).
    """
    drive, names, start = make_drive(LIFT, 102)
    return drive, names, start, run_wheel_filter(config(drive, names), tables(drive))


def test_a_lift_is_detected_with_its_start_and_end_and_costs_little(lifted_run):
    drive, (name,), start, run = lifted_run
    (slip_period,) = run.report.slips[name]
    assert slip_period.start == pytest.approx(start, abs=0.3)
    assert slip_period.end == pytest.approx(start + 6.0, abs=0.5)
    # Believing the wheel would shorten the path by 7 %; 1.8 m are 1.5 % of 120 m.
    assert end_error(drive, run) < 1.8
    assert nees(drive, run) < 12.0
    lines = run.report.as_json()["warnings"]
    assert any("the wheel slipped" in line and f"t = {slip_period.start:.1f} to" in line for line in lines)
    entry = run.report.as_json()["slips"][0]
    assert entry["node"] == name and entry["speed"] < -0.5 and entry["from"] < entry["to"]


def test_during_a_lift_the_inertial_speed_is_within_its_growing_sigma(lifted_run):
    drive, _, start, run = lifted_run
    track = run.track
    indices = np.searchsorted(track.t, [start - 1.0, start + 5.5, start + 8.0])
    sigma_before, end_sigma, sigma_after = np.sqrt(track.covariance[indices, 3, 3])
    assert end_sigma > 10.0 * sigma_before > 0.0 and sigma_after < 2.0 * sigma_before
    speed = np.interp(track.t - 0.05, drive.t, drive.speed)
    inside = (track.t > start + 1.0) & (track.t < start + 5.9)
    speed_error = np.abs(track.speed - speed)[inside]
    assert speed_error.max() < 0.3
    assert (speed_error < 3.0 * np.sqrt(track.covariance[inside, 3, 3]) + 0.02).all()


def test_live_odometry_equals_bulk_bit_by_bit_across_a_rollback(lifted_run):
    drive, (name,), _, run = lifted_run
    node, live, poses = drive.nodes[name], WheelFilter(config(drive, (name,))), []
    for t, gyro, accel in zip(node.t.tolist(), node.gyro.tolist(), node.accel.tolist(), strict=True):
        poses += live.handle(WheelSample(name, t, tuple(gyro), tuple(accel))).poses
    poses += live.finish().poses
    for field in ("x", "heading", "speed", "covariance"):
        assert getattr(track_from_poses(poses), field).tobytes() == getattr(run.track, field).tobytes(), field


@pytest.mark.parametrize("lag", first_and_more(8.0, np.inf))
def test_smoothing_uses_the_speeds_before_and_after_a_lift(lifted_run, lag):
    """The largest sigma falls below 0.3 of the forward filter's and covers the error."""
    drive, names, start, run = lifted_run
    smoothed = run_wheel_filter(config(drive, names), tables(drive), lag)
    track, inside = smoothed.track, (run.track.t > start) & (run.track.t < start + 6.0)
    sigma, forward_sigma = (np.sqrt(each_track.covariance[inside, 3, 3]) for each_track in (track, run.track))
    assert sigma.max() < 0.3 * forward_sigma.max()
    speed_error = np.abs(track.speed - np.interp(track.t - 0.05, drive.t, drive.speed))[inside]
    assert (speed_error < 3.0 * sigma).all() and speed_error[-1] < 0.1
    x, y, _ = true_pose(drive, track.t[-1])
    assert np.hypot(track.x[-1] - x, track.y[-1] - y) < 1.05 * end_error(drive, run) + 0.02


@pytest.mark.parametrize("name", [name for name in CASES if "3 s" not in name and "half" not in name])
def test_each_kind_of_slip_is_detected_without_false_alarms(name):
    """Seed 110. Wheels that spin down slowly look like a rising road; `make road` prints those."""
    case = CASES[name]
    result = outcome(case, 110)
    print(name, result)
    assert result.detected == (0 if "nothing" in name else case.wheels)
    assert result.false == 0
    # Hills, roughness and uncalibrated nodes alone cause errors up to 3 %.
    assert result.error < 3.5 and result.nees < 16.0


@pytest.mark.parametrize("seed", first_and_more(71, 83))
def test_carelessly_measured_wheels_are_still_used_as_one_axle(seed):
    """Radii are wrong by 2 % and the track width by 3 % (1σ); 18 of 40 such drives had been taken for two
    axles.
    """
    result = careless_outcome(seed)
    assert result.false == 0 and result.error < 2.0, result


@pytest.mark.parametrize(
    ("node_sets", "n_runs"),
    first_and_more(([("left", "right")], 3), (slip.car.SETS, 10)),
    ids=["both", "all"],
)
def test_no_slip_is_detected_on_real_drives(node_sets, n_runs):
    wanted.recording("car")
    alarms = count_real_alarms(node_sets)
    assert len(alarms) == n_runs and not any(alarms.values()), alarms


def test_each_slip_is_reported_live_once_after_its_end():
    drive, names, start = make_drive(CASES["two wheels, 1.5 s of double spin"], 112)
    mounts = {name: NodeMount(name, "left") for name in names}
    odometer = Odometer(Vehicle(drive.radius, drive.track, mounts), 0)
    warnings: list[tuple[float, str]] = []
    size = 26
    for start_index in range(0, max(len(node.t) for node in drive.nodes.values()), size):
        for name, node in drive.nodes.items():
            part = slice(start_index, start_index + size)
            t_ns = np.round(node.t[part] * 1e9).astype(np.int64)
            if len(t_ns):
                odometer.handle(ImuBlock(name, node.gyro[part], node.accel[part], None, 0, t_ns=t_ns))
        warnings += [(node.t[part][-1], line) for line in odometer.warnings() if len(node.t[part])]
    odometer.finish()
    warnings += [(np.inf, line) for line in odometer.warnings(end=True)]
    slip_warnings = [(t, line) for t, line in warnings if "the wheel slipped" in line]
    assert sorted(line.partition(":")[0] for _, line in slip_warnings) == ["left", "right"]
    assert all(start + 1.5 < t < start + 4.0 for t, _ in slip_warnings), (start, slip_warnings)


def test_the_result_table_counts_false_alarms():
    case = CASES["one wheel, nothing happens"]
    assert "detected   0 of   0, false alarms 2" in slip.table_row(
        "one wheel, nothing happens", case, [slip.Outcome(1.0, 3.0, 1, 1)]
    )


@pytest.mark.parametrize("side", first_and_more("left", "right"))
def test_a_steered_wheel_is_excluded_and_named(side):
    """Seed 101: a tricycle whose two nodes are declared as one axle."""
    result, fixed_wheel_used = slip.steered_outcome(101, side)
    print(side, result)
    assert result.detected == 1 and fixed_wheel_used
    assert result.error < 2.0 and result.nees < 16.0


def test_swapped_sides_cost_no_more_than_a_single_wheel():
    """Seed 100: the node declared left sits on the right wheel and is used as such."""
    result = slip.swapped_sides_outcome(100)
    drive, _, _ = make_drive(CASES["two wheels, nothing happens"], 100)
    right_only = run_wheel_filter(config(drive, ("right",)), tables(drive))
    assert result.detected == 1
    assert result.error == pytest.approx(100.0 * end_error(drive, right_only) / drive.length, abs=0.01)


def test_a_declared_steered_wheel_is_used_only_if_it_is_the_only_one():
    nodes = {"left": NodeMount("left", "left"), "front": NodeMount("right", "left", steered=True)}
    both = wheel_config(Vehicle(0.15, 0.5, nodes), list(nodes))
    assert list(both.nodes) == ["left"]
    alone = wheel_config(Vehicle(0.15, 0.5, {"front": nodes["front"]}), ["front"])
    assert initial_state(alone).wheels[0].geometry.contact_y == 0.0


@pytest.mark.parametrize("seed", first_and_more(5068, 5126))
def test_accelerometer_errors_on_a_slow_wheel_are_not_detected_as_slip(seed):
    # Scale errors and biases of the two axes rotate with the wheel; below one turn in 10 s that looks like a
    # slope.
    random_drive = mixed_drives.drawn(seed)
    assert random_drive.top_speed < 0.5 and not random_drive.slips
    run = run_wheel_filter(config(random_drive.drive, ("left",)), tables(random_drive.drive))
    assert run.filter.core.wheels[0].slip_detector.slips == []
    assert end_error(random_drive.drive, run) < 0.1 * random_drive.drive.length


@pytest.mark.parametrize("seed", first_and_more(5012, 5100))
def test_a_slip_of_seconds_does_not_mean_another_axle(seed):
    random_drive = mixed_drives.drawn(seed)
    run = run_wheel_filter(config(random_drive.drive), tables(random_drive.drive))
    assert len(run.filter.core.wheels) == 2
    assert [len(wheel.slip_detector.slips) for wheel in run.filter.core.wheels] == [0, 1]
    # The 0.999 quantile of chi-square with three degrees of freedom.
    assert nees(random_drive.drive, run) < 16.3


def test_an_inertial_speed_far_beyond_the_maximum_is_discarded_for_the_wheel_speed():
    detector = SlipDetector()
    detector.start_slip(100)
    agreeing = ForwardResidual(0.0, 1e-4, 0.0, 1e-6, 0.0, 0.0)
    assert not detector.detect_end(101, agreeing, slip=-1.0, variance=0.01, inertial_speed=2.0, max_speed=2.0)
    assert detector.is_slipping
    # The wheel speed is usual; the inertial speed is beyond twice the maximum so far.
    assert detector.detect_end(102, agreeing, slip=-3.0, variance=0.01, inertial_speed=4.1, max_speed=2.0)
    assert not detector.is_slipping and detector.slips[-1].last == 101


def test_a_slip_ends_after_twenty_seconds_at_the_latest():
    detector = SlipDetector()
    detector.start_slip(0)
    disagreeing = ForwardResidual(1.0, 1e-4, 1.0, 1e-6, 0.0, 0.0)
    ended = [
        n
        for n in range(1, 300)
        if detector.is_slipping and detector.detect_end(n, disagreeing, 1.0, 0.01, 1.0, 2.0)
    ]
    assert ended == [200]


AGREEING, DISAGREEING = (
    ForwardResidual(0.0, 1e-4, 0.0, 0.0, 0.0, 0.0),
    ForwardResidual(0.5, 1e-4, 0.5, 0.0, 0.0, 0.0),
)
STANDSTILL = "standstill"


def detect_slip(*phases, rate=2.0):
    """Return the window in which a slip began, None if none is detected.

    phases: pairs of a number of windows and a ForwardResidual, None (not measured) or STANDSTILL.
    """
    detector, number = SlipDetector(), 0
    for windows, residual in phases:
        for _ in range(windows):
            number += 1
            if residual is STANDSTILL:
                detector.record_standstill()
            elif (onset := detector.detect_onset(number, residual, rate)) is not None:
                return onset
    return None


def test_slip_detection_requires_two_seconds_of_agreement_before():
    assert detect_slip((20, AGREEING), (3, DISAGREEING)) == 21
    assert detect_slip((19, AGREEING), (30, DISAGREEING)) is None
    assert detect_slip((19, AGREEING), (1, DISAGREEING), (19, AGREEING), (30, DISAGREEING)) is None
    assert detect_slip((19, AGREEING), (1, DISAGREEING), (20, AGREEING), (3, DISAGREEING)) == 41
    assert detect_slip((60, AGREEING), (3, DISAGREEING), rate=0.9) is None, "a wheel that hardly turns"
    # Residuals up to three sigma, 0.03 m/s, agree.
    for residual, onset in ((0.029, 21), (-0.029, 21), (0.031, None), (-0.031, None)):
        assert detect_slip((20, AGREEING._replace(residual=residual)), (3, DISAGREEING)) == onset


def test_after_twenty_seconds_of_standstill_agreement_is_required_again():
    assert detect_slip((20, AGREEING), (199, STANDSTILL), (3, DISAGREEING)) == 220
    assert detect_slip((20, AGREEING), (200, STANDSTILL), (30, DISAGREEING)) is None
    assert detect_slip((20, AGREEING), (200, STANDSTILL), (19, AGREEING), (30, DISAGREEING)) is None
    assert (
        detect_slip((20, AGREEING), (199, STANDSTILL), (1, AGREEING), (199, STANDSTILL), (3, DISAGREEING))
        == 420
    )


def test_sums_restart_after_standstill_and_after_a_window_without_residual():
    """A residual of 0.3 m/s² is 4.4 sigma in one second and 4.6 sigma in two."""
    drifting = AGREEING._replace(residual=0.0305)
    assert detect_slip((20, AGREEING), (20, drifting)) is not None
    assert detect_slip((20, AGREEING), *[(10, drifting), (1, None)] * 3) is None
    assert detect_slip((20, AGREEING), *[(10, drifting), (1, STANDSTILL)] * 3) is None
    for end in (None, STANDSTILL):
        assert detect_slip((20, AGREEING), (10, drifting), (1, end), (50, AGREEING)) is None


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_slope_state_that_absorbs_the_slip_counts_as_slip(sign):
    """A sudden slope of 3 m/s² in 0.1 s counts as 0.3 m/s; a slope that was there before does not."""
    on_slope = AGREEING._replace(slope=sign * 3.0)
    assert detect_slip((21, AGREEING), (1, on_slope)) == 21
    assert detect_slip((20, AGREEING), (70, on_slope)) is None


@pytest.mark.parametrize(("factor", "onset"), [(0.98, None), (1.02, 21)])
def test_accelerometer_ripple_raises_the_threshold_of_a_slow_wheel(factor, onset):
    """Ripple of 0.15 m/s² that the slope follows in 2 s, constant residual of 0.05 m/s², white noise."""
    sigma = np.sqrt(10 * 1e-4 + 0.05**2 + (0.15 / np.hypot(1.0, 2.0 * 1.05)) ** 2)
    drifting = AGREEING._replace(residual=factor * 4.5 * sigma / 10)
    assert detect_slip((20, AGREEING), (10, drifting), rate=1.05) == onset


def test_a_slip_exceeds_4_5_sigma_and_0_2_metres_per_second():
    """Sigma in 0.1 s: white noise, correlated states, drift of 0.05 m/s², 0.15 m/s² per yaw rate, ripple."""
    rate = 2.0
    sigma = np.sqrt(
        0.04**2 + (0.03 + 0.15 * 0.8 * 0.1) ** 2 + 0.005**2 + (0.015 / np.hypot(1.0, 2.0 * rate)) ** 2
    )
    for factor, onset in ((0.98, None), (1.02, 21)):
        for sign in (1.0, -1.0):
            forward = ForwardResidual(sign * factor * 4.5 * sigma, 0.04**2, 0.0, 0.03**2, 0.0, -0.8)
            assert detect_slip((20, AGREEING), (1, forward), rate=rate) == onset
    for residual, onset in ((0.19, None), (0.21, 21), (-0.19, None), (-0.21, 21)):
        assert detect_slip((20, AGREEING), (1, AGREEING._replace(residual=residual))) == onset
