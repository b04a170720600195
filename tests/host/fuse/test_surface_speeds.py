"""Surface speeds of another odometer: alone, with GNSS, and as a measurement beside wheel nodes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from generators import wheel_drives
from generators.gnss_drives import geodetic
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import ENCODER_LEFT, ENCODER_RIGHT, SPEED, TRACK_WIDTH, YAW_RATE
from hubodo.fuse.wheel.initial_state import initial_state
from hubodo.fuse.wheel.measurements.surface_speed import STATES, measure
from hubodo.fuse.wheel.surface_speeds import average_surface_speeds
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.log.csv_folder import write_folder
from hubodo.recording import Recording, Table
from in_process import hubodo
from vehicles import vehicle_toml
from wheel_runs import BOTH, config, pose_error, tables

SEED = 9
VEHICLE = vehicle_toml(0.15, 0.5, frame=True)


def driven(seed=SEED, length=80.0):
    """A drive, and what encoders of its wheels told at 50 Hz; each has its own scale, 1 sigma 1 %."""
    rng = np.random.default_rng(seed)
    drive = wheel_drives.drive(wheel_drives.loop(rng, length, 5.0), rng)
    yaw_rate, every = np.gradient(drive.heading, drive.t), slice(None, None, 20)
    columns = {"t": drive.t[every]}
    for name, side in (("left", 1.0), ("right", -1.0)):
        speed = drive.speed - yaw_rate * 0.5 * side * drive.track
        noise = 0.01 * rng.standard_normal(len(drive.t))
        columns[name] = ((1.0 + 0.01 * rng.standard_normal()) * speed + noise)[every]
    return drive, Table(columns)


def recorded(drive, wheels, names=(), **more):
    """The log of these nodes."""
    nodes = {name: table for name, table in tables(drive).items() if name in names}
    true = {"t": drive.t, "x": drive.x, "y": drive.y, "heading": drive.heading}
    told = Table({name: column[::50] for name, column in true.items()})
    return Recording(nodes, wheels=wheels, truth=told, **more)


@pytest.fixture
def fuse(tmp_path):
    """fuse.json of a recording, from a CSV folder."""

    def run_on(recording):
        (tmp_path / "vehicle.toml").write_text(VEHICLE)
        write_folder(recording, tmp_path / "log")
        words = ("--vehicle", tmp_path / "vehicle.toml", "-o", tmp_path / "out")
        done = hubodo("fuse", tmp_path / "log", *words)
        assert done.code == 0, done.err
        return json.loads((tmp_path / "out" / "fuse.json").read_text())

    return run_on


def test_derivatives_are_differences():
    nodes = {"left": WheelNode("left", "left")}
    begin = initial_state(WheelConfig(0.15, 0.5, nodes, encoder_aided=True))
    at, rng = begin.columns.vehicle, np.random.default_rng(1)
    x = [0.0] * len(begin.x)
    for entry in (SPEED, YAW_RATE, TRACK_WIDTH, ENCODER_LEFT, ENCODER_RIGHT):
        x[at[entry]] = float(0.3 * rng.standard_normal())
    for side in (1.0, -1.0):
        _, variance, found = measure(x, at, side, 0.25 * side, 1.1)
        assert variance > 0.0
        for entry in STATES:
            ends = []
            for step in (1e-6, -1e-6):
                moved = list(x)
                moved[at[entry]] += step
                ends.append(measure(moved, at, side, 0.25 * side, 1.1)[0])
            # The residual is measured less expected.
            assert found.get(entry, 0.0) == pytest.approx(-(ends[0] - ends[1]) / 2e-6, abs=1e-8)


def test_means_over_windows_are_those_of_the_straight_lines_and_holes_are_left_out():
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.005, 0.05, 400))
    t = np.where(t > 5.0, t + 2.0, t)
    left = np.sin(t)
    found = average_surface_speeds(Table({"t": t, "left": left, "right": 2.0 * left}))
    for number, (one, other) in found.items():
        grid = np.linspace(0.1 * number, 0.1 * number + 0.1, 20_001)
        assert one == pytest.approx(np.trapezoid(np.interp(grid, t, left), grid) / 0.1, abs=1e-6)
        assert other == pytest.approx(2.0 * one)
    begin, end = t[np.argmax(np.diff(t))], t[np.argmax(np.diff(t)) + 1]
    assert all(0.1 * number >= end or 0.1 * number + 0.1 <= begin for number in found)
    assert len(found) == pytest.approx(10.0 * (t[-1] - t[0] - (end - begin)), abs=4)


def test_alone_and_with_fixes_they_make_a_track(fuse):
    drive, wheels = driven()
    t = drive.t[::200]
    rng = np.random.default_rng(SEED)
    x, y = (np.interp(t, drive.t, way) + rng.standard_normal(len(t)) for way in (drive.x, drive.y))
    latitude, longitude = geodetic(x, y, 47.37, 8.54)
    columns = {
        "t": t,
        "latitude_deg": latitude,
        "longitude_deg": longitude,
        "altitude": 0 * t,
        "sigma": 0 * t + 1,
    }
    found = fuse(recorded(drive, wheels, gnss=Table(columns)))
    assert found["methods"][0] == "differential odometry on wheel speeds" and "fixes" in found["methods"][1]
    assert found["truth"]["final_error"] < 1.5


def test_a_node_that_is_on_no_wheel_is_said_to_be_left_out(fuse):
    drive, wheels = driven()
    recording = recorded(drive, wheels, ("left",))
    found = fuse(replace(recording, nodes={"frame": recording.nodes["left"]}))
    assert found["warnings"] == [
        "frame: on no wheel of the vehicle file; the track comes from wheels.csv alone"
    ]


def test_beside_a_node_they_are_used_and_it_is_said(fuse):
    drive, wheels = driven()
    found = fuse(recorded(drive, wheels, ("left",)))
    assert "wheel filter on left with the surface speeds of another odometer" in found["methods"][0]
    assert any("comes from left and wheels.csv" in line for line in found["warnings"])
    assert found["truth"]["final_error"] < 2.0


@pytest.mark.parametrize("names", [("left",), BOTH])
def test_beside_nodes_the_track_is_honest_and_surer(names):
    """NEES at the end over eight drives."""
    honest = []
    for seed in range(SEED, SEED + 5):
        drive, wheels = driven(seed)
        plain = run_wheel_filter(config(drive, names), tables(drive))
        found = run_wheel_filter(
            config(drive, names, encoder_aided=True), tables(drive), 0.0, average_surface_speeds(wheels)
        )
        error, covariance = pose_error(drive, found.track, -1)
        honest.append(float(error @ np.linalg.solve(covariance, error)))
        assert np.trace(covariance[:2, :2]) < np.trace(plain.track.covariance[-1, :2, :2])
    print(f"seeds {SEED}..{SEED + 4}: NEES {np.mean(honest):.2f} of 3")
    assert np.mean(honest) < 2.0 * 3.0


def test_smoothing_beside_an_encoder_ends_as_the_filter_does():
    """Its measurements count in the last step too."""
    drive, wheels = driven()
    speeds = average_surface_speeds(wheels)
    settings = config(drive, ("left",), encoder_aided=True)
    plain, *smoothed = (
        run_wheel_filter(settings, tables(drive), lag, speeds).track for lag in (0.0, 2.0, np.inf)
    )
    for track in smoothed:
        assert track.covariance[-1] == pytest.approx(plain.covariance[-1], rel=1e-6, abs=1e-12)
        assert (track.x[-1], track.y[-1]) == pytest.approx((plain.x[-1], plain.y[-1]), abs=1e-9)


def test_they_carry_the_vehicle_over_a_silence_of_its_node():
    drive, wheels = driven()
    node = drive.nodes["left"]
    keep = (node.t < 20.0) | (node.t > 30.0)
    drive.nodes["left"] = replace(node, t=node.t[keep], gyro=node.gyro[keep], accel=node.accel[keep])
    found = run_wheel_filter(
        config(drive, ("left",), encoder_aided=True), tables(drive), 0.0, average_surface_speeds(wheels)
    )
    assert found.report.outages == ()
    place = int(np.searchsorted(found.track.t, 30.2))
    error, covariance = pose_error(drive, found.track, place)
    print(f"seed {SEED}: {np.hypot(*error[:2]):.2f} m off, {np.degrees(error[2]):.1f}°")
    assert np.hypot(*error[:2]) < 1.5 and np.sqrt(np.trace(covariance[:2, :2])) < 1.5
    assert error @ np.linalg.solve(covariance, error) < 20.0


def test_the_speed_of_a_window_is_the_mean_of_the_lines_between_rows_where_none_is_missing():
    """Rows at uneven times, a hole among them: by the area below the lines, put together from its corners."""
    rng = np.random.default_rng(31)
    t = 0.234 + np.cumsum(rng.uniform(0.01, 0.15, 120))
    t[60:] += 0.9
    rows = {side: 1.0 + rng.standard_normal(120) for side in ("left", "right")}
    found = average_surface_speeds(Table({"t": t, **rows}))
    windows = [k for k in range(200) if t[0] <= 0.1 * k and 0.1 * (k + 1) <= t[-1]]
    sound = [k for k in windows if 0.1 * (k + 1) <= t[59] or 0.1 * k >= t[60]]
    assert list(found) == sound and len(sound) < len(windows) - 8
    for number in sound:
        begin, end = 0.1 * number, 0.1 * (number + 1)
        corners = np.union1d(t[(t > begin) & (t < end)], [begin, end])
        for side, mean in zip(("left", "right"), found[number], strict=True):
            assert mean == pytest.approx(np.trapezoid(np.interp(corners, t, rows[side]), corners) / 0.1)


@pytest.mark.parametrize("speed", [0.0, 1.0, -20.0])
def test_an_encoder_is_unsure_by_two_centimetres_a_second_and_a_hundredth(speed):
    begin = initial_state(WheelConfig(0.15, 0.5, {"left": WheelNode("left", "left")}, encoder_aided=True))
    _, variance, _ = measure(list(begin.x), begin.columns.vehicle, 1.0, 0.25, speed)
    assert variance == pytest.approx(0.02**2 + (0.01 * speed) ** 2)
