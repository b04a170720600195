"""Surface speeds from another odometer: alone, with GNSS fixes, and as a measurement beside wheel nodes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from generators import wheel_drives
from generators.gnss_drives import geodetic
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import ENCODER_LEFT, ENCODER_RIGHT, SPEED, TRACK_WIDTH, YAW_RATE
from hubodo.fuse.wheel.measurements.surface_speed import STATES, measure
from hubodo.fuse.wheel.state_vector import initial_state
from hubodo.fuse.wheel.surface_speeds import average_surface_speeds
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.log.csv_folder import write_folder
from hubodo.recording import Recording, Table
from in_process import hubodo
from repetitions import first_and_more
from vehicles import vehicle_toml
from wheel_runs import BOTH, config, pose_error, tables

SEED = 9
VEHICLE = vehicle_toml(0.15, 0.5, frame=True)


def simulate_encoder_drive(seed=SEED, length=80.0):
    """Return a drive and 50 Hz encoder speeds of its wheels, each with a scale error of 1 % (1σ)."""
    rng = np.random.default_rng(seed)
    drive = wheel_drives.drive(wheel_drives.loop(rng, length, 5.0), rng)
    yaw_rate, every = np.gradient(drive.heading, drive.t), slice(None, None, 20)
    columns = {"t": drive.t[every]}
    for name, side in (("left", 1.0), ("right", -1.0)):
        speed = drive.speed - yaw_rate * 0.5 * side * drive.track
        noise = 0.01 * rng.standard_normal(len(drive.t))
        columns[name] = ((1.0 + 0.01 * rng.standard_normal()) * speed + noise)[every]
    return drive, Table(columns)


def make_recording(drive, wheels, names=(), **tables_by_name):
    """Return a recording of the named nodes with the encoder speeds and the true trajectory."""
    nodes = {name: table for name, table in tables(drive).items() if name in names}
    columns = {"t": drive.t, "x": drive.x, "y": drive.y, "heading": drive.heading}
    truth = Table({name: column[::50] for name, column in columns.items()})
    return Recording(nodes, wheels=wheels, truth=truth, **tables_by_name)


@pytest.fixture
def fuse(tmp_path):
    """Return a function that fuses a recording read from a CSV folder and returns its fuse.json."""

    def run_fuse(recording):
        (tmp_path / "vehicle.toml").write_text(VEHICLE)
        write_folder(recording, tmp_path / "log")
        options = ("--vehicle", tmp_path / "vehicle.toml", "-o", tmp_path / "out")
        result = hubodo("fuse", tmp_path / "log", *options)
        assert result.code == 0, result.err
        return json.loads((tmp_path / "out" / "fuse.json").read_text())

    return run_fuse


def test_encoder_derivatives_equal_central_differences():
    nodes = {"left": WheelNode("left", "left")}
    initial = initial_state(WheelConfig(0.15, 0.5, nodes, encoder_aided=True))
    columns, rng = initial.columns.vehicle, np.random.default_rng(1)
    x = [0.0] * len(initial.x)
    for entry in (SPEED, YAW_RATE, TRACK_WIDTH, ENCODER_LEFT, ENCODER_RIGHT):
        x[columns[entry]] = float(0.3 * rng.standard_normal())
    for side in (1.0, -1.0):
        _, variance, derivatives = measure(x, columns, side, 0.25 * side, 1.1)
        assert variance > 0.0
        for entry in STATES:
            residuals = []
            for step in (1e-6, -1e-6):
                shifted = list(x)
                shifted[columns[entry]] += step
                residuals.append(measure(shifted, columns, side, 0.25 * side, 1.1)[0])
            # The residual is the measurement minus the prediction, hence the sign.
            assert derivatives.get(entry, 0.0) == pytest.approx(
                -(residuals[0] - residuals[1]) / 2e-6, abs=1e-8
            )


def test_window_means_integrate_linear_interpolation_and_omit_gaps():
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.005, 0.05, 400))
    t = np.where(t > 5.0, t + 2.0, t)
    left = np.sin(t)
    means = average_surface_speeds(Table({"t": t, "left": left, "right": 2.0 * left}))
    for number, (mean_left, mean_right) in means.items():
        grid = np.linspace(0.1 * number, 0.1 * number + 0.1, 20_001)
        assert mean_left == pytest.approx(np.trapezoid(np.interp(grid, t, left), grid) / 0.1, abs=1e-6)
        assert mean_right == pytest.approx(2.0 * mean_left)
    gap_start, gap_end = t[np.argmax(np.diff(t))], t[np.argmax(np.diff(t)) + 1]
    assert all(0.1 * number >= gap_end or 0.1 * number + 0.1 <= gap_start for number in means)
    assert len(means) == pytest.approx(10.0 * (t[-1] - t[0] - (gap_end - gap_start)), abs=4)


def test_encoder_speeds_and_fixes_alone_give_a_track(fuse):
    drive, wheels = simulate_encoder_drive()
    t = drive.t[::200]
    rng = np.random.default_rng(SEED)
    x, y = (
        np.interp(t, drive.t, coordinate) + rng.standard_normal(len(t)) for coordinate in (drive.x, drive.y)
    )
    latitude, longitude = geodetic(x, y, 47.37, 8.54)
    columns = {
        "t": t,
        "latitude_deg": latitude,
        "longitude_deg": longitude,
        "altitude": 0 * t,
        "sigma": 0 * t + 1,
    }
    result = fuse(make_recording(drive, wheels, gnss=Table(columns)))
    assert result["methods"][0] == "differential odometry on wheel speeds" and "fixes" in result["methods"][1]
    assert result["truth"]["final_error"] < 1.5


def test_a_warning_names_a_node_that_is_on_no_wheel(fuse):
    drive, wheels = simulate_encoder_drive()
    recording = make_recording(drive, wheels, ("left",))
    result = fuse(replace(recording, nodes={"frame": recording.nodes["left"]}))
    assert result["warnings"] == [
        "frame: on no wheel of the vehicle file; the track comes from wheels.csv alone"
    ]


def test_encoder_speeds_aid_a_wheel_node_and_a_warning_says_so(fuse):
    drive, wheels = simulate_encoder_drive()
    result = fuse(make_recording(drive, wheels, ("left",)))
    assert "wheel filter on left with the surface speeds of another odometer" in result["methods"][0]
    assert any("comes from left and wheels.csv" in line for line in result["warnings"])
    assert result["truth"]["final_error"] < 2.0


@pytest.mark.parametrize("names", first_and_more((("left",),), (BOTH,)))
def test_encoder_speeds_keep_the_track_consistent_and_reduce_its_covariance(names):
    """Compare the mean NEES at the end of three drives with twice its expectation."""
    nees_values = []
    for seed in range(SEED, SEED + 3):
        drive, wheels = simulate_encoder_drive(seed)
        unaided = run_wheel_filter(config(drive, names), tables(drive))
        aided = run_wheel_filter(
            config(drive, names, encoder_aided=True), tables(drive), 0.0, average_surface_speeds(wheels)
        )
        error, covariance = pose_error(drive, aided.track, -1)
        nees_values.append(float(error @ np.linalg.solve(covariance, error)))
        assert np.trace(covariance[:2, :2]) < np.trace(unaided.track.covariance[-1, :2, :2])
    print(f"seeds {SEED}..{SEED + 2}: NEES {np.mean(nees_values):.2f} of 3")
    assert np.mean(nees_values) < 2.0 * 3.0


def test_smoothing_with_an_encoder_leaves_the_last_pose_unchanged():
    """The smoothed end also includes the encoder measurement of the last step."""
    drive, wheels = simulate_encoder_drive(length=30.0)
    speeds = average_surface_speeds(wheels)
    settings = config(drive, ("left",), encoder_aided=True)
    forward, *smoothed = (
        run_wheel_filter(settings, tables(drive), lag, speeds).track for lag in (0.0, 2.0, np.inf)
    )
    for track in smoothed:
        assert track.covariance[-1] == pytest.approx(forward.covariance[-1], rel=1e-6, abs=1e-12)
        assert (track.x[-1], track.y[-1]) == pytest.approx((forward.x[-1], forward.y[-1]), abs=1e-9)


def test_encoder_speeds_bridge_an_outage_of_the_node():
    drive, wheels = simulate_encoder_drive()
    node = drive.nodes["left"]
    keep = (node.t < 20.0) | (node.t > 30.0)
    drive.nodes["left"] = replace(node, t=node.t[keep], gyro=node.gyro[keep], accel=node.accel[keep])
    run = run_wheel_filter(
        config(drive, ("left",), encoder_aided=True), tables(drive), 0.0, average_surface_speeds(wheels)
    )
    assert run.report.outages == ()
    after_outage = int(np.searchsorted(run.track.t, 30.2))
    error, covariance = pose_error(drive, run.track, after_outage)
    print(f"seed {SEED}: {np.hypot(*error[:2]):.2f} m off, {np.degrees(error[2]):.1f}°")
    assert np.hypot(*error[:2]) < 1.5 and np.sqrt(np.trace(covariance[:2, :2])) < 1.5
    assert error @ np.linalg.solve(covariance, error) < 20.0


def test_window_speeds_of_uneven_rows_equal_the_trapezoidal_mean():
    """Compare with the trapezoidal rule over unevenly spaced rows with a gap of 0.9 s."""
    rng = np.random.default_rng(31)
    t = 0.234 + np.cumsum(rng.uniform(0.01, 0.15, 120))
    t[60:] += 0.9
    rows = {side: 1.0 + rng.standard_normal(120) for side in ("left", "right")}
    means = average_surface_speeds(Table({"t": t, **rows}))
    windows = [k for k in range(200) if t[0] <= 0.1 * k and 0.1 * (k + 1) <= t[-1]]
    gap_free = [k for k in windows if 0.1 * (k + 1) <= t[59] or 0.1 * k >= t[60]]
    assert list(means) == gap_free and len(gap_free) < len(windows) - 8
    for number in gap_free:
        start, end = 0.1 * number, 0.1 * (number + 1)
        knots = np.union1d(t[(t > start) & (t < end)], [start, end])
        for side, mean in zip(("left", "right"), means[number], strict=True):
            assert mean == pytest.approx(np.trapezoid(np.interp(knots, t, rows[side]), knots) / 0.1)


@pytest.mark.parametrize("speed", [0.0, 1.0, -20.0])
def test_encoder_noise_is_two_centimetres_per_second_plus_one_percent(speed):
    initial = initial_state(WheelConfig(0.15, 0.5, {"left": WheelNode("left", "left")}, encoder_aided=True))
    _, variance, _ = measure(list(initial.x), initial.columns.vehicle, 1.0, 0.25, speed)
    assert variance == pytest.approx(0.02**2 + (0.01 * speed) ** 2)
