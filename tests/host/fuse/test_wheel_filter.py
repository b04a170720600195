"""The wheel filter as a user meets it: same bits in any portions, honest sigmas, slip, damaged logs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generators import wheel_drives
from hubodo.calibration.file import Quantity
from hubodo.fuse.wheel.entries import TIME_OFFSET
from hubodo.fuse.wheel.filter import WheelFilter, WheelSample
from hubodo.fuse.wheel.track import run_wheel_filter, track_from_poses
from wheel_runs import BOTH, config, end_error, short, tables, truth

SHORT = short(3)
SHORT_BULK = track_from_poses(
    [
        *(made := WheelFilter(config(SHORT)))
        .handle_many({name: (node.t, node.gyro, node.accel) for name, node in SHORT.nodes.items()})
        .poses,
        *made.finish().poses,
    ]
)


def _same_bits(found: list[object]) -> None:
    track = track_from_poses(found)  # type: ignore[arg-type]
    for field in ("t", "x", "y", "heading", "speed", "yaw_rate", "covariance"):
        assert getattr(track, field).tobytes() == getattr(SHORT_BULK, field).tobytes(), field


def test_single_samples_give_the_bits_of_the_whole_log() -> None:
    made, poses = WheelFilter(config(SHORT)), []
    samples = [
        WheelSample(name, t, tuple(g), tuple(a))
        for name, node in SHORT.nodes.items()
        for t, g, a in zip(node.t.tolist(), node.gyro.tolist(), node.accel.tolist(), strict=True)
    ]
    for sample in sorted(samples, key=lambda sample: sample.t):
        poses += made.handle(sample).poses
        made.state()
    _same_bits([*poses, *made.finish().poses])


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1))
def test_blocks_of_any_size_give_the_bits_of_the_whole_log(seed: int) -> None:
    rng = np.random.default_rng(seed)
    made, poses = WheelFilter(config(SHORT)), []
    cuts = np.sort(rng.uniform(0.0, SHORT.t[-1], 60))
    # A node may be up to a second ahead of the other.
    ahead = {name: rng.uniform(0.0, 0.3) for name in BOTH}
    for begin, end in zip([-1.0, *cuts], [*cuts, 1e9], strict=True):
        blocks = {}
        for name in BOTH:
            node = SHORT.nodes[name]
            pick = (node.t > begin + ahead[name]) & (node.t <= end + ahead[name])
            if begin < 0:
                pick |= node.t <= begin + ahead[name]
            blocks[name] = (node.t[pick], node.gyro[pick], node.accel[pick])
        poses += made.handle_many(blocks).poses
    _same_bits([*poses, *made.finish().poses])


def test_the_live_state_is_the_truth_between_poses_too() -> None:
    drive = short(4)
    made = WheelFilter(config(drive))
    samples = sorted(
        (
            WheelSample(name, t, tuple(g), tuple(a))
            for name, node in drive.nodes.items()
            for t, g, a in zip(node.t.tolist(), node.gyro.tolist(), node.accel.tolist(), strict=True)
        ),
        key=lambda sample: sample.t,
    )
    worst_late, worst, worst_jump = 0.0, 0.0, 0.0
    off = None
    for sample in samples:
        made.handle(sample)
        state = made.state()
        if state is not None and sample.t > 8.0:
            x, y, _ = truth(drive, state.t)
            before, off = off, np.array([state.x - x, state.y - y])
            worst = max(worst, float(np.hypot(*off)))
            if before is not None:
                worst_jump = max(worst_jump, float(np.hypot(*(off - before))))
            worst_late = max(worst_late, sample.t - state.t)
    # 25 m; a pose carried on for a tenth of a second adds nothing to 1 %.
    assert worst < 0.25
    # A place that stood between poses would fall behind by what is rolled in a tenth of a second.
    assert worst_jump < 0.03
    assert worst_late <= 0.011


def test_slip_of_one_wheel_is_found_on_that_wheel_and_costs_little() -> None:
    seed = 8
    plan = wheel_drives.legs([(6.0, 0.0, 0.0), (20.0, 1.2, 0.1), (3.0, 0.0, 0.0)])
    clean = wheel_drives.drive(plan, np.random.default_rng(seed))
    plan = wheel_drives.with_slip(plan, "right", 14.0, 1.5, 0.8)
    drive = wheel_drives.drive(plan, np.random.default_rng(seed))
    for names in (BOTH, ("right",)):
        found = run_wheel_filter(config(drive, names), tables(drive))
        counts = found.report.counts
        assert counts["right"]["windows_slipping"] > 5, f"seed {seed}"
        assert set(found.report.slips) == {"right"} and len(found.report.slips["right"]) == 1
        if "left" in counts:
            assert counts["left"]["windows_slipping"] <= 1
        # 1.2 m of slip; a tenth of it is left, by the good wheel or by the accelerometer.
        before = end_error(clean, run_wheel_filter(config(clean, names), tables(clean)))
        print(f"seed {seed}, {names}: {before:.2f} m without slip, {end_error(drive, found):.2f} m with it")
        assert end_error(drive, found) < before + 0.12


def test_clock_offset_between_the_nodes_is_found() -> None:
    seed = 21
    rng = np.random.default_rng(seed)
    parts = [(6.0, 0.0, 0.0)] + [(2.0, 1.5 if k % 2 else 0.5, 0.2 * (-1) ** k) for k in range(20)]
    drive = wheel_drives.drive(wheel_drives.legs(parts), rng, replace(wheel_drives.Errors(), clock=0.0))
    late = drive.nodes["right"]
    drive.nodes["right"] = replace(late, t=late.t + 0.025)
    offset = run_wheel_filter(
        config(drive, priors={TIME_OFFSET: Quantity(0.0, 0.03)}), tables(drive)
    ).report.vehicle["time_offset"]["delay"]
    assert offset.value == pytest.approx(0.025, abs=max(0.003, 3 * offset.sigma))


def test_spin_beyond_the_gyro_is_carried_by_gravity_and_centripetal_force() -> None:
    """0.15 m wheels at 6.2 m/s turn at 2370 deg/s; the gyro stops at 2000."""
    seed = 6
    rng = np.random.default_rng(seed)
    plan = wheel_drives.legs(
        [(6.0, 0.0, 0.0), (6.0, 3.0, 0.1), (6.0, 6.2, 0.05), (5.0, 3.0, 0.0), (3.0, 0.0, 0.0)]
    )
    errors = replace(wheel_drives.Errors(), scale=0.003)
    drive = wheel_drives.drive(plan, rng, errors, arm=(0.02, 0.01), rate_hz=208.0)
    length = drive.length
    naive = run_wheel_filter(config(drive, ("left",), limits={"gyro_limit": 1e9}), tables(drive))
    for names in (("left",), BOTH):
        found = run_wheel_filter(config(drive, names), tables(drive))
        assert found.report.counts["left"]["windows_clipped"] > 30, f"seed {seed}"
        assert end_error(drive, found) < 0.015 * length
        assert any("gz at its limit" in line for line in found.report.warnings)
    assert end_error(drive, naive) > 0.04 * length


@pytest.mark.parametrize("node", BOTH)
def test_a_node_mounted_the_other_way_round_is_named(node: str) -> None:
    drive = short(12, facing={node: "right"})
    found = run_wheel_filter(config(drive), tables(drive))
    assert any(node in line and "facing" in line for line in found.report.warnings), found.report.warnings
    # Its speed is not used from then on, and the sigma covers what went wrong before.
    assert end_error(drive, found) < 2.5 * np.sqrt(np.trace(found.track.covariance[-1, :2, :2]))
    assert end_error(drive, found) < 0.15 * drive.length


def test_exchanged_sides_are_named() -> None:
    drive = short(13)
    recorded = tables(drive)
    found = run_wheel_filter(config(drive), {"left": recorded["right"], "right": recorded["left"]})
    assert any("exchanged" in line for line in found.report.warnings)


def test_a_drive_without_rest_gives_a_track_and_says_so() -> None:
    rng = np.random.default_rng(14)
    plan = wheel_drives.legs([(15.0, 1.2, 0.2), (10.0, 1.5, -0.1)])
    drive = wheel_drives.drive(plan, rng)
    found = run_wheel_filter(config(drive), tables(drive))
    assert any("no rest at the start" in line for line in found.report.warnings)
    begin = found.track.t[0]
    x0, y0, h0 = truth(drive, begin)
    x, y, _ = truth(drive, found.track.t[-1])
    cos, sin = np.cos(h0), np.sin(h0)
    ahead = np.array([cos * (x - x0) + sin * (y - y0), -sin * (x - x0) + cos * (y - y0)])
    error = np.hypot(found.track.x[-1] - ahead[0], found.track.y[-1] - ahead[1])
    assert error < 0.05 * drive.length
    rested = run_wheel_filter(config(SHORT), tables(SHORT))
    assert found.track.covariance[20, 2, 2] > rested.track.covariance[20, 2, 2]


def test_wheels_that_never_turn_stay_at_the_origin_and_say_so() -> None:
    rng = np.random.default_rng(15)
    drive = wheel_drives.drive(wheel_drives.legs([(12.0, 0.0, 0.0)]), rng)
    found = run_wheel_filter(config(drive), tables(drive))
    assert sum("turned only" in line for line in found.report.warnings) == 2
    assert np.hypot(found.track.x[-1], found.track.y[-1]) < 0.01


def test_a_missing_node_is_said_and_the_other_carries_on_with_larger_sigma() -> None:
    alone = run_wheel_filter(config(SHORT), {"left": tables(SHORT)["left"]})
    assert any("right: no samples" in line for line in alone.report.warnings)
    assert alone.track.covariance[-1, 2, 2] > SHORT_BULK.covariance[-1, 2, 2]
    assert end_error(SHORT, alone) < 0.02 * SHORT.length


def test_a_clock_that_jumps_back_is_said_and_its_samples_are_counted() -> None:
    node = SHORT.nodes["right"]
    half = len(node.t) // 2
    t = np.concatenate([node.t[:half], node.t[half:] - 3.0])
    made = WheelFilter(config(SHORT))
    left = SHORT.nodes["left"]
    poses = made.handle_many(
        {"left": (left.t, left.gyro, left.accel), "right": (t, node.gyro, node.accel)}
    ).poses
    assert made.refused["right"] == pytest.approx(3.0 * 104, rel=0.05)
    assert len(poses) > 200


def test_one_false_time_stamp_costs_one_sample_in_both_ways_of_feeding() -> None:
    node = SHORT.nodes["left"]
    t = node.t.copy()
    t[1000] = 1e7
    t[1500] = -3.0
    bulk, live = (WheelFilter(config(SHORT, ("left",))) for _ in range(2))
    poses = [*bulk.handle_many({"left": (t, node.gyro, node.accel)}).poses, *bulk.finish().poses]
    single = []
    for at, gyro, accel in zip(t.tolist(), node.gyro.tolist(), node.accel.tolist(), strict=True):
        single += live.handle(WheelSample("left", at, tuple(gyro), tuple(accel))).poses
    single += live.finish().poses
    assert bulk.refused["left"] == live.refused["left"] == 2
    assert track_from_poses(poses).covariance.tobytes() == track_from_poses(single).covariance.tobytes()


def test_a_gap_of_both_nodes_makes_the_sigma_grow() -> None:
    drive = short(16)
    for name, node in drive.nodes.items():
        keep = (node.t < 12.0) | (node.t > 15.0)
        drive.nodes[name] = replace(node, t=node.t[keep], gyro=node.gyro[keep], accel=node.accel[keep])
    found = run_wheel_filter(config(drive), tables(drive))
    before, after = (int(np.searchsorted(found.track.t, t)) for t in (11.9, 15.2))
    grown = np.sqrt(np.trace(found.track.covariance[after, :2, :2]))
    assert grown > 0.5 > np.sqrt(np.trace(found.track.covariance[before, :2, :2]))
    x, y, _ = truth(drive, found.track.t[after])
    assert np.hypot(found.track.x[after] - x, found.track.y[after] - y) < 4.0 * grown
    assert sum("left and right: not heard from t = 11.9" in line for line in found.report.warnings) == 1


def test_one_wheel_reports_no_track_width() -> None:
    assert run_wheel_filter(config(SHORT, ("left",)), tables(SHORT)).report.vehicle == {}
