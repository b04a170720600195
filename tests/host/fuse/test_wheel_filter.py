"""The wheel filter as users call it: bulk and live odometry, slip, mounting errors, damaged logs."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generators import wheel_drives
from hubodo.calibration.file import Quantity
from hubodo.fuse.wheel.entries import TIME_OFFSET
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.preintegration import WheelSample
from hubodo.fuse.wheel.track import WheelTrack, run_wheel_filter, track_from_poses
from wheel_runs import (
    BOTH,
    config,
    end_error,
    sample_columns,
    samples_in_time_order,
    short_loop,
    tables,
    true_pose,
)

SHORT = short_loop(3)


@cache
def _short_bulk() -> WheelTrack:
    """Return the bulk odometry of SHORT."""
    bulk = WheelFilter(config(SHORT))
    return track_from_poses([*bulk.handle_blocks(sample_columns(SHORT)).poses, *bulk.finish().poses])


def _assert_equal_bits(poses: list[object]) -> None:
    """Assert that the track of these poses equals the bulk odometry of SHORT bit by bit."""
    track = track_from_poses(poses)  # type: ignore[arg-type]
    for field in ("t", "x", "y", "heading", "speed", "yaw_rate", "covariance"):
        assert getattr(track, field).tobytes() == getattr(_short_bulk(), field).tobytes(), field


def test_live_odometry_equals_bulk_bit_by_bit() -> None:
    live, poses = WheelFilter(config(SHORT)), []
    for sample in samples_in_time_order(sample_columns(SHORT)):
        poses += live.handle(sample).poses
        live.state()
    _assert_equal_bits([*poses, *live.finish().poses])


@settings(max_examples=5)
@given(st.integers(0, 2**32 - 1))
def test_blocks_of_any_size_equal_bulk_bit_by_bit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    live, poses = WheelFilter(config(SHORT)), []
    cuts = np.sort(rng.uniform(0.0, SHORT.t[-1], 60))
    # A node may be up to 0.3 s ahead of the other.
    ahead = {name: rng.uniform(0.0, 0.3) for name in BOTH}
    for start, end in zip([-1.0, *cuts], [*cuts, 1e9], strict=True):
        blocks = {}
        for name in BOTH:
            node = SHORT.nodes[name]
            selected = (node.t > start + ahead[name]) & (node.t <= end + ahead[name])
            if start < 0:
                selected |= node.t <= start + ahead[name]
            blocks[name] = (node.t[selected], node.gyro[selected], node.accel[selected])
        poses += live.handle_blocks(blocks).poses
    _assert_equal_bits([*poses, *live.finish().poses])


def test_the_live_state_extrapolates_smoothly_between_poses() -> None:
    drive = short_loop(4)
    live = WheelFilter(config(drive))
    max_delay, max_error, max_jump = 0.0, 0.0, 0.0
    error = None
    for sample in samples_in_time_order(sample_columns(drive)):
        live.handle(sample)
        state = live.state()
        if state is not None and sample.t > 8.0:
            x, y, _ = true_pose(drive, state.t)
            previous, error = error, np.array([state.x - x, state.y - y])
            max_error = max(max_error, float(np.hypot(*error)))
            if previous is not None:
                max_jump = max(max_jump, float(np.hypot(*(error - previous))))
            max_delay = max(max_delay, sample.t - state.t)
    # 1 % of 25 m; extrapolating a pose by up to 0.1 s adds nothing to that.
    assert max_error < 0.25
    # A position held between poses would fall behind by the distance rolled in 0.1 s.
    assert max_jump < 0.03
    assert max_delay <= 0.011


def test_slip_is_detected_on_the_slipping_wheel_and_costs_little() -> None:
    seed = 8
    plan = wheel_drives.legs([(6.0, 0.0, 0.0), (20.0, 1.2, 0.1), (3.0, 0.0, 0.0)])
    clean = wheel_drives.drive(plan, np.random.default_rng(seed))
    plan = wheel_drives.with_slip(plan, "right", 14.0, 1.5, 0.8)
    drive = wheel_drives.drive(plan, np.random.default_rng(seed))
    for names in (BOTH, ("right",)):
        run = run_wheel_filter(config(drive, names), tables(drive))
        counts = run.report.counts
        assert counts["right"]["windows_slipping"] > 5, f"seed {seed}"
        assert set(run.report.slips) == {"right"} and len(run.report.slips["right"]) == 1
        if "left" in counts:
            assert counts["left"]["windows_slipping"] <= 1
        # The wheel slips by 1.2 m; the other wheel or the accelerometer corrects nine tenths of that.
        error_without_slip = end_error(clean, run_wheel_filter(config(clean, names), tables(clean)))
        error = end_error(drive, run)
        print(f"seed {seed}, {names}: {error_without_slip:.2f} m without slip, {error:.2f} m with it")
        assert error < error_without_slip + 0.12


def test_the_clock_offset_between_two_nodes_is_estimated() -> None:
    seed = 21
    rng = np.random.default_rng(seed)
    parts = [(6.0, 0.0, 0.0)] + [(2.0, 1.5 if k % 2 else 0.5, 0.2 * (-1) ** k) for k in range(20)]
    drive = wheel_drives.drive(wheel_drives.legs(parts), rng, replace(wheel_drives.Errors(), clock=0.0))
    delayed = drive.nodes["right"]
    drive.nodes["right"] = replace(delayed, t=delayed.t + 0.025)
    offset = run_wheel_filter(
        config(drive, priors={TIME_OFFSET: Quantity(0.0, 0.03)}), tables(drive)
    ).report.vehicle["time_offset"]["delay"]
    assert offset.value == pytest.approx(0.025, abs=max(0.003, 3 * offset.sigma))


def test_a_spin_rate_beyond_the_gyro_range_is_estimated_from_gravity_and_centripetal_force() -> None:
    """Wheels of 0.15 m at 6.2 m/s turn at 2370 deg/s; the gyro saturates at 2000 deg/s."""
    seed = 6
    rng = np.random.default_rng(seed)
    plan = wheel_drives.legs(
        [(6.0, 0.0, 0.0), (6.0, 3.0, 0.1), (6.0, 6.2, 0.05), (5.0, 3.0, 0.0), (3.0, 0.0, 0.0)]
    )
    errors = replace(wheel_drives.Errors(), scale=0.003)
    drive = wheel_drives.drive(plan, rng, errors, arm=(0.02, 0.01), rate_hz=208.0)
    length = drive.length
    without_limit = run_wheel_filter(config(drive, ("left",), limits={"gyro_limit": 1e9}), tables(drive))
    for names in (("left",), BOTH):
        run = run_wheel_filter(config(drive, names), tables(drive))
        assert run.report.counts["left"]["windows_clipped"] > 30, f"seed {seed}"
        assert end_error(drive, run) < 0.015 * length
        assert any("gz at its limit" in line for line in run.report.warnings)
    assert end_error(drive, without_limit) > 0.04 * length


@pytest.mark.parametrize("node", BOTH)
def test_a_node_with_reversed_facing_is_named_in_a_warning(node: str) -> None:
    drive = short_loop(12, facing={node: "right"})
    run = run_wheel_filter(config(drive), tables(drive))
    assert any(node in line and "facing" in line for line in run.report.warnings), run.report.warnings
    # From then on its speed is not used, and sigma covers the error made before.
    assert end_error(drive, run) < 2.5 * np.sqrt(np.trace(run.track.covariance[-1, :2, :2]))
    assert end_error(drive, run) < 0.15 * drive.length


def test_swapped_sides_are_named_in_a_warning() -> None:
    drive = short_loop(13)
    recorded = tables(drive)
    run = run_wheel_filter(config(drive), {"left": recorded["right"], "right": recorded["left"]})
    assert any("exchanged" in line for line in run.report.warnings)


def test_a_drive_without_standstill_gives_a_track_and_a_warning() -> None:
    rng = np.random.default_rng(14)
    plan = wheel_drives.legs([(15.0, 1.2, 0.2), (10.0, 1.5, -0.1)])
    drive = wheel_drives.drive(plan, rng)
    run = run_wheel_filter(config(drive), tables(drive))
    assert any("no rest at the start" in line for line in run.report.warnings)
    start = run.track.t[0]
    x0, y0, h0 = true_pose(drive, start)
    x, y, _ = true_pose(drive, run.track.t[-1])
    cos, sin = np.cos(h0), np.sin(h0)
    displacement = np.array([cos * (x - x0) + sin * (y - y0), -sin * (x - x0) + cos * (y - y0)])
    error = np.hypot(run.track.x[-1] - displacement[0], run.track.y[-1] - displacement[1])
    assert error < 0.05 * drive.length
    run_with_standstill = run_wheel_filter(config(SHORT), tables(SHORT))
    assert run.track.covariance[20, 2, 2] > run_with_standstill.track.covariance[20, 2, 2]


def test_wheels_that_never_turn_stay_at_the_origin_with_a_warning() -> None:
    rng = np.random.default_rng(15)
    drive = wheel_drives.drive(wheel_drives.legs([(12.0, 0.0, 0.0)]), rng)
    run = run_wheel_filter(config(drive), tables(drive))
    assert sum("turned only" in line for line in run.report.warnings) == 2
    assert np.hypot(run.track.x[-1], run.track.y[-1]) < 0.01


def test_without_one_node_the_other_gives_a_track_with_larger_sigma_and_a_warning() -> None:
    run = run_wheel_filter(config(SHORT), {"left": tables(SHORT)["left"]})
    assert any("right: no samples" in line for line in run.report.warnings)
    assert run.track.covariance[-1, 2, 2] > _short_bulk().covariance[-1, 2, 2]
    assert end_error(SHORT, run) < 0.02 * SHORT.length


def test_samples_after_a_backward_clock_jump_are_refused_and_counted() -> None:
    node = SHORT.nodes["right"]
    half = len(node.t) // 2
    t = np.concatenate([node.t[:half], node.t[half:] - 3.0])
    wheel_filter = WheelFilter(config(SHORT))
    left = SHORT.nodes["left"]
    poses = wheel_filter.handle_blocks(
        {"left": (left.t, left.gyro, left.accel), "right": (t, node.gyro, node.accel)}
    ).poses
    assert wheel_filter.rejected_samples["right"] == pytest.approx(3.0 * 104, rel=0.05)
    assert len(poses) > 200


def test_a_wrong_time_stamp_costs_one_sample_in_bulk_and_live() -> None:
    node = SHORT.nodes["left"]
    t = node.t.copy()
    t[1000] = 1e7
    t[1500] = -3.0
    bulk, live = (WheelFilter(config(SHORT, ("left",))) for _ in range(2))
    bulk_poses = [*bulk.handle_blocks({"left": (t, node.gyro, node.accel)}).poses, *bulk.finish().poses]
    live_poses = []
    for stamp, gyro, accel in zip(t.tolist(), node.gyro.tolist(), node.accel.tolist(), strict=True):
        live_poses += live.handle(WheelSample("left", stamp, tuple(gyro), tuple(accel))).poses
    live_poses += live.finish().poses
    assert bulk.rejected_samples["left"] == live.rejected_samples["left"] == 2
    assert (
        track_from_poses(bulk_poses).covariance.tobytes() == track_from_poses(live_poses).covariance.tobytes()
    )


def test_a_gap_of_both_nodes_increases_sigma_to_cover_the_error() -> None:
    drive = short_loop(16)
    for name, node in drive.nodes.items():
        keep = (node.t < 12.0) | (node.t > 15.0)
        drive.nodes[name] = replace(node, t=node.t[keep], gyro=node.gyro[keep], accel=node.accel[keep])
    run = run_wheel_filter(config(drive), tables(drive))
    before, after = (int(np.searchsorted(run.track.t, t)) for t in (11.9, 15.2))
    position_sigma = np.sqrt(np.trace(run.track.covariance[after, :2, :2]))
    assert position_sigma > 0.5 > np.sqrt(np.trace(run.track.covariance[before, :2, :2]))
    x, y, _ = true_pose(drive, run.track.t[after])
    assert np.hypot(run.track.x[after] - x, run.track.y[after] - y) < 4.0 * position_sigma
    assert sum("left and right: not heard from t = 11.9" in line for line in run.report.warnings) == 1


def test_one_wheel_does_not_report_a_track_width() -> None:
    assert run_wheel_filter(config(SHORT, ("left",)), tables(SHORT)).report.vehicle == {}
