"""The wheel filter as a user meets it: same bits in any portions, honest sigmas, slip, damaged logs."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from generators import wheel_drives
from hubodo.calibration.file import Quantity
from hubodo.fuse.wheel.config import WheelConfig, WheelNode, WheelNoise
from hubodo.fuse.wheel.entries import SLOPE, TIME_OFFSET
from hubodo.fuse.wheel.filter import START, WheelFilter, WheelSample
from hubodo.fuse.wheel.fixed_lag import smooth_with_lag
from hubodo.fuse.wheel.track import WheelRun, collect, run
from hubodo.recording import Table

BOTH = ("left", "right")


def _tables(drive: wheel_drives.WheelDrive) -> dict[str, Table]:
    made = {}
    for name, node in drive.nodes.items():
        columns = np.column_stack([node.t, node.gyro, node.accel]).T
        made[name] = Table(dict(zip(("t", "gx", "gy", "gz", "ax", "ay", "az"), columns, strict=True)))
    return made


def _config(drive: wheel_drives.WheelDrive, names: tuple[str, ...] = BOTH, **changes: object) -> WheelConfig:
    nodes = {name: WheelNode(name, "left") for name in names}  # type: ignore[arg-type]
    return replace(WheelConfig(drive.radius, drive.track, nodes), **changes)  # type: ignore[arg-type]


def _truth(drive: wheel_drives.WheelDrive, t: float) -> tuple[float, float, float]:
    return tuple(float(np.interp(t, drive.t, column)) for column in (drive.x, drive.y, drive.heading))  # type: ignore[return-value]


def _error(drive: wheel_drives.WheelDrive, found: WheelRun) -> float:
    x, y, _ = _truth(drive, found.track.t[-1])
    return float(np.hypot(found.track.x[-1] - x, found.track.y[-1] - y))


def _short(seed: int, **options: object) -> wheel_drives.WheelDrive:
    rng = np.random.default_rng(seed)
    return wheel_drives.drive(wheel_drives.loop(rng, 25.0, 5.0), rng, **options)  # type: ignore[arg-type]


SHORT = _short(3)
SHORT_BULK = collect(
    [
        *(made := WheelFilter(_config(SHORT)))
        .handle_many({name: (node.t, node.gyro, node.accel) for name, node in SHORT.nodes.items()})
        .poses,
        *made.finish().poses,
    ]
)


def _same_bits(found: list[object]) -> None:
    track = collect(found)  # type: ignore[arg-type]
    for field in ("t", "x", "y", "heading", "speed", "yaw_rate", "covariance"):
        assert getattr(track, field).tobytes() == getattr(SHORT_BULK, field).tobytes(), field


def test_single_samples_give_the_bits_of_the_whole_log() -> None:
    made, poses = WheelFilter(_config(SHORT)), []
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
    made, poses = WheelFilter(_config(SHORT)), []
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
    drive = _short(4)
    made = WheelFilter(_config(drive))
    samples = sorted(
        (
            WheelSample(name, t, tuple(g), tuple(a))
            for name, node in drive.nodes.items()
            for t, g, a in zip(node.t.tolist(), node.gyro.tolist(), node.accel.tolist(), strict=True)
        ),
        key=lambda sample: sample.t,
    )
    worst_late, worst = 0.0, 0.0
    for sample in samples:
        made.handle(sample)
        state = made.state()
        if state is not None and sample.t > 8.0:
            x, y, _ = _truth(drive, state.t)
            worst = max(worst, float(np.hypot(state.x - x, state.y - y)))
            worst_late = max(worst_late, sample.t - state.t)
    # 25 m; a pose carried on for a tenth of a second adds nothing to 1 %.
    assert worst < 0.25
    assert worst_late <= 0.011


def test_innovations_and_errors_are_inside_their_chi_square_bands() -> None:
    """With noise as declared and no error that the model does not know. 16 drives, seeds 600..615."""
    errors = wheel_drives.Errors(roll=0.0, vibration=0.0, road=0.002, clock=0.003, warmup=0.0)
    # Flat ground; 'push' is how far the wheel's own acceleration strays by the road's noise.
    noise = WheelNoise(
        gyro=1e-4,
        accel=1.2e-3,
        roll=2e-3,
        flex=0.0,
        push=0.1,
        vibration=0.0,
        sway=0.06,
        road=0.002,
        lateral=3e-4,
    )
    nees, nis, degrees = [], 0.0, 0
    for seed in range(600, 616):
        rng = np.random.default_rng(seed)
        drive = wheel_drives.drive(wheel_drives.loop(rng, 40.0, 6.0), rng, errors)
        found = run(_config(drive, noise=noise, known={SLOPE: Quantity(0.0, 0.03)}), _tables(drive))
        x, y, heading = _truth(drive, found.track.t[-1])
        error = np.array([found.track.x[-1] - x, found.track.y[-1] - y, found.track.heading[-1] - heading])
        nees.append(error @ np.linalg.solve(found.track.covariance[-1, :3, :3], error))
        moving = found.track.still == 0
        nis += found.track.nis[moving].sum()
        # Yaw rate and speed are free in each window: two of the ten numbers set them.
        degrees += int((found.track.degrees[moving] - 2).sum())
    print("mean NEES", np.mean(nees), "of 3; NIS per degree", nis / degrees)
    low, high = chi2.ppf([0.005, 0.995], 3 * len(nees))
    assert low < sum(nees) < high, nees
    # White numbers would lie within 2 %; the generator's road and quantisation are not quite white.
    assert 0.85 < nis / degrees < 1.1


def test_two_wheels_are_not_worse_than_the_better_one() -> None:
    """Median over six drives, seeds 40..45."""
    errors = {names: [] for names in (("left",), ("right",), BOTH)}
    for seed in range(40, 46):
        rng = np.random.default_rng(seed)
        drive = wheel_drives.drive(wheel_drives.loop(rng, 100.0, 6.0), rng)
        for names, found in errors.items():
            found.append(_error(drive, run(_config(drive, names), _tables(drive))))
    better = np.median(np.minimum(errors["left",], errors["right",]))
    both = np.median(errors[BOTH])
    print(errors)
    # Half of a percent of the way is what six drives can tell.
    assert both < better + 0.5


def test_slip_of_one_wheel_is_found_on_that_wheel_and_costs_little() -> None:
    seed = 8
    rng = np.random.default_rng(seed)
    plan = wheel_drives.legs([(6.0, 0.0, 0.0), (20.0, 1.2, 0.1), (3.0, 0.0, 0.0)])
    plan = wheel_drives.with_slip(plan, "right", 14.0, 1.5, 0.8)
    drive = wheel_drives.drive(plan, rng)
    both = run(_config(drive), _tables(drive))
    slipping = run(_config(drive, ("right",)), _tables(drive))
    counts = both.report.counts
    assert counts["right"]["windows_slipping"] > 5, f"seed {seed}"
    assert counts["left"]["windows_slipping"] <= 1
    # 1.2 m of slip; the good wheel leaves a tenth of it.
    assert _error(drive, both) < 0.3
    assert _error(drive, slipping) > 0.8


def test_clock_offset_between_the_nodes_is_found() -> None:
    seed = 21
    rng = np.random.default_rng(seed)
    parts = [(6.0, 0.0, 0.0)] + [(2.0, 1.5 if k % 2 else 0.5, 0.2 * (-1) ** k) for k in range(20)]
    drive = wheel_drives.drive(wheel_drives.legs(parts), rng, replace(wheel_drives.Errors(), clock=0.0))
    late = drive.nodes["right"]
    drive.nodes["right"] = replace(late, t=late.t + 0.025)
    offset = run(_config(drive, known={TIME_OFFSET: Quantity(0.0, 0.03)}), _tables(drive)).report.vehicle[
        "time_offset"
    ]["delay"]
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
    naive = run(_config(drive, ("left",), gyro_limit=1e9), _tables(drive))
    for names in (("left",), BOTH):
        found = run(_config(drive, names), _tables(drive))
        assert found.report.counts["left"]["windows_clipped"] > 30, f"seed {seed}"
        assert _error(drive, found) < 0.015 * length
        assert any("gz at its limit" in line for line in found.report.warnings)
    assert _error(drive, naive) > 0.04 * length


def test_smoothing_lowers_the_error_along_the_way_and_keeps_the_end() -> None:
    drive = _short(9)
    plain, smooth = (run(_config(drive), _tables(drive), lag=value) for value in (0.0, np.inf))
    assert smooth.track.x[-1] == pytest.approx(plain.track.x[-1], abs=1e-6)
    middle = len(plain.track.t) // 2
    assert smooth.track.covariance[middle, 2, 2] <= plain.track.covariance[middle, 2, 2]
    assert "smoothed" in smooth.report.method
    assert "not causal" in smooth.report.method


def test_a_lag_as_long_as_the_log_is_the_whole_log_and_no_lag_is_the_filter() -> None:
    drive = _short(9)
    config, tables = _config(drive), _tables(drive)
    plain, whole = run(config, tables), run(config, tables, lag=np.inf)
    steps = run(config, tables, lag=1.0).filter.steps
    assert steps is not None
    as_it_was = collect(smooth_with_lag(config, steps, START, 0))
    as_whole = collect(smooth_with_lag(config, steps, START, len(steps)))
    for name in ("t", "x", "y", "heading", "speed", "yaw_rate", "covariance"):
        np.testing.assert_array_equal(getattr(as_it_was, name), getattr(plain.track, name))
        np.testing.assert_allclose(getattr(as_whole, name), getattr(whole.track, name), rtol=1e-6, atol=1e-8)


def test_a_longer_lag_never_makes_the_heading_less_sure_and_ends_as_the_filter() -> None:
    drive = _short(9)
    config, tables = _config(drive), _tables(drive)
    tracks = [run(config, tables, lag=lag).track for lag in (0.0, 0.5, 2.0, 8.0, np.inf)]
    for shorter, longer in itertools.pairwise(tracks):
        assert np.all(longer.covariance[:, 2, 2] <= shorter.covariance[:, 2, 2] * (1.0 + 1e-6))
    middle = len(tracks[0].t) // 2
    assert tracks[2].covariance[middle, 2, 2] < 0.999 * tracks[0].covariance[middle, 2, 2]
    assert [tracks[2].x[-1], tracks[2].y[-1]] == pytest.approx([tracks[0].x[-1], tracks[0].y[-1]], abs=1e-6)


@pytest.mark.parametrize("node", BOTH)
def test_a_node_mounted_the_other_way_round_is_named(node: str) -> None:
    drive = _short(12, facing={node: "right"})
    found = run(_config(drive), _tables(drive))
    assert any(node in line and "facing" in line for line in found.report.warnings), found.report.warnings
    # Its speed is not used from then on, and the sigma covers what went wrong before.
    assert _error(drive, found) < 2.5 * np.sqrt(np.trace(found.track.covariance[-1, :2, :2]))
    assert _error(drive, found) < 0.15 * drive.length


def test_exchanged_sides_are_named() -> None:
    drive = _short(13)
    tables = _tables(drive)
    found = run(_config(drive), {"left": tables["right"], "right": tables["left"]})
    assert any("exchanged" in line for line in found.report.warnings)


def test_a_drive_without_rest_gives_a_track_and_says_so() -> None:
    rng = np.random.default_rng(14)
    plan = wheel_drives.legs([(15.0, 1.2, 0.2), (10.0, 1.5, -0.1)])
    drive = wheel_drives.drive(plan, rng)
    found = run(_config(drive), _tables(drive))
    assert any("no rest at the start" in line for line in found.report.warnings)
    begin = found.track.t[0]
    x0, y0, h0 = _truth(drive, begin)
    x, y, _ = _truth(drive, found.track.t[-1])
    cos, sin = np.cos(h0), np.sin(h0)
    ahead = np.array([cos * (x - x0) + sin * (y - y0), -sin * (x - x0) + cos * (y - y0)])
    error = np.hypot(found.track.x[-1] - ahead[0], found.track.y[-1] - ahead[1])
    assert error < 0.05 * drive.length
    rested = run(_config(SHORT), _tables(SHORT))
    assert found.track.covariance[20, 2, 2] > rested.track.covariance[20, 2, 2]


def test_wheels_that_never_turn_stay_at_the_origin_and_say_so() -> None:
    rng = np.random.default_rng(15)
    drive = wheel_drives.drive(wheel_drives.legs([(12.0, 0.0, 0.0)]), rng)
    found = run(_config(drive), _tables(drive))
    assert sum("turned only" in line for line in found.report.warnings) == 2
    assert np.hypot(found.track.x[-1], found.track.y[-1]) < 0.01


def test_a_missing_node_is_said_and_the_other_carries_on_with_larger_sigma() -> None:
    tables = _tables(SHORT)
    alone = run(_config(SHORT), {"left": tables["left"]})
    assert any("right: no samples" in line for line in alone.report.warnings)
    assert alone.track.covariance[-1, 2, 2] > SHORT_BULK.covariance[-1, 2, 2]
    assert _error(SHORT, alone) < 0.02 * SHORT.length


def test_a_clock_that_jumps_back_is_said_and_its_samples_are_counted() -> None:
    node = SHORT.nodes["right"]
    half = len(node.t) // 2
    t = np.concatenate([node.t[:half], node.t[half:] - 3.0])
    made = WheelFilter(_config(SHORT))
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
    bulk, live = (WheelFilter(_config(SHORT, ("left",))) for _ in range(2))
    poses = [*bulk.handle_many({"left": (t, node.gyro, node.accel)}).poses, *bulk.finish().poses]
    single = []
    for at, gyro, accel in zip(t.tolist(), node.gyro.tolist(), node.accel.tolist(), strict=True):
        single += live.handle(WheelSample("left", at, tuple(gyro), tuple(accel))).poses
    single += live.finish().poses
    assert bulk.refused["left"] == live.refused["left"] == 2
    assert collect(poses).covariance.tobytes() == collect(single).covariance.tobytes()


def test_a_gap_of_both_nodes_makes_the_sigma_grow() -> None:
    drive = _short(16)
    for name, node in drive.nodes.items():
        keep = (node.t < 12.0) | (node.t > 15.0)
        drive.nodes[name] = replace(node, t=node.t[keep], gyro=node.gyro[keep], accel=node.accel[keep])
    found = run(_config(drive), _tables(drive))
    before, after = (int(np.searchsorted(found.track.t, t)) for t in (11.9, 15.2))
    grown = np.sqrt(np.trace(found.track.covariance[after, :2, :2]))
    assert grown > 0.5 > np.sqrt(np.trace(found.track.covariance[before, :2, :2]))
    x, y, _ = _truth(drive, found.track.t[after])
    assert np.hypot(found.track.x[after] - x, found.track.y[after] - y) < 4.0 * grown
    assert sum("not heard" in line for line in found.report.warnings) == 2


def test_one_wheel_reports_no_track_width() -> None:
    assert run(_config(SHORT, ("left",)), _tables(SHORT)).report.vehicle == {}


def test_errors_of_the_node_are_found_while_driving() -> None:
    """Spin scale, tilt, lever arm and biases of a 100 m drive, within four of their sigmas. Seed 30."""
    rng = np.random.default_rng(30)
    errors = replace(wheel_drives.Errors(), warmup=0.0, vibration=0.0)
    drive = wheel_drives.drive(wheel_drives.loop(rng, 100.0, 6.0), rng, errors)
    found = run(_config(drive), _tables(drive))
    for name, node in drive.nodes.items():
        quantities = found.report.nodes[name]
        for truth, effect, parameter in (
            ("spin_scale", "gyro_scale_factor", "z"),
            ("arm_x", "lever_arm", "x"),
            ("arm_y", "lever_arm", "y"),
            ("tilt_x", "node_misalignment", "x"),
            ("tilt_y", "node_misalignment", "y"),
        ):
            found_one = quantities[effect][parameter]
            off = abs(found_one.value - node.truth[truth])
            assert off < 4.0 * found_one.sigma + 1e-3, (name, effect, parameter)
