"""The demo from start to end: its track compared with the truth and two simpler methods."""

import io
import json
import re
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from hubodo.cli import main
from hubodo.demo.scenario import TRACK_WIDTH, VEHICLE_TOML, WHEEL_RADIUS, make_scenario
from hubodo.demo.simulated_drive import choose_interpreter, record_drive
from hubodo.log.recording_reader import read_recording
from hubodo.model.drive import loop_drive
from hubodo.pages.page import COLOURS
from hubodo.verbs import demo as verb
from in_process import hubodo

DRAWN = "fused from the two wheels"
MOVING, SEED = 5.0, 7


@pytest.fixture(scope="module")
def rides():
    """Run the demo and return the state of its nodes."""
    return []


@pytest.fixture(scope="module")
def demo(tmp_path_factory, rides):
    """Return the output of the demo with a short drive."""
    printed = io.StringIO()
    run = verb.record_drive

    def captured(*words, **more):
        rides.append(run(*words, **more))
        return rides[-1]

    words = ["demo", "--moving", str(MOVING), "--seed", str(SEED), "-o", str(tmp_path_factory.mktemp("demo"))]
    with redirect_stdout(printed), pytest.MonkeyPatch.context() as patch:
        patch.setattr(verb, "record_drive", captured)
        assert main([*words, "--json"]) == 0
    return json.loads(printed.getvalue())


@pytest.fixture(scope="module")
def truth():
    """Return x, y of the drive on a fine grid, integrated independently."""
    drive = make_scenario(SEED, MOVING).drive
    t = np.linspace(drive.speed.start, drive.speed.end, 40_001)
    heading = cumulative_trapezoid(drive.yaw_rate(t), t, initial=0.0)
    speed = drive.speed(t)
    x = cumulative_trapezoid(speed * np.cos(heading), t, initial=0.0)
    y = cumulative_trapezoid(speed * np.sin(heading), t, initial=0.0)
    return np.stack([x, y], axis=1)


def drawn(page):
    """Return x, y of the track in the page, (N, 2) m, read from the path and the ticks of its figure."""
    figure = next(part for part in page.split("<svg")[1:] if DRAWN in part)
    paths = re.findall(rf'<path d="([^"]+)"[^>]*stroke: [^;]*{COLOURS["fused"]}', figure)
    # The last path of a colour is that of the legend.
    pixels = np.array([pair.split() for pair in re.findall(r"[ML] ([^\n]+)", paths[0])], float)
    track = []
    for axis, place in (("x", 0), ("y", 1)):
        ticks = re.findall(
            rf'id="{axis}tick_.*?<use [^>]*x="([^"]+)" y="([^"]+)".*?<text[^>]*>([^<]+)</text>',
            figure,
            re.DOTALL,
        )
        at = np.array([float(tick[place]) for tick in ticks])
        labels = np.array([float(tick[2].replace("\N{MINUS SIGN}", "-")) for tick in ticks])
        scale = (labels[-1] - labels[0]) / (at[-1] - at[0])
        track.append(labels[0] + scale * (pixels[:, place] - at[0]))
    return np.stack(track, axis=1)


def dead_reckoning(log):
    """Return the end point by dead reckoning with taped geometry and the raw spin rates."""
    left, right = (read_recording(log).nodes[name] for name in ("left", "right"))
    t = np.arange(max(left.t[0], right.t[0]), min(left.t[-1], right.t[-1]), 0.002)
    spin = [np.interp(t, node.t, node["gz"]) for node in (left, right)]
    speed, yaw_rate = WHEEL_RADIUS * (spin[0] + spin[1]) / 2, WHEEL_RADIUS * (spin[1] - spin[0]) / TRACK_WIDTH
    heading = cumulative_trapezoid(yaw_rate, t, initial=0.0)
    return np.array([np.trapezoid(speed * np.cos(heading), t), np.trapezoid(speed * np.sin(heading), t)])


def test_both_nodes_are_recorded_completely(demo):
    assert sorted(demo["recorded"]["nodes"]) == ["left", "right"]
    assert str(Path(demo["page"]).parent) not in (Path(demo["page"]).parent / "demo.json").read_text("utf-8")
    for node in demo["recorded"]["nodes"].values():
        assert (node["samples_lost"], node["frames_lost"], node["gaps"]) == (0, 0, {})


def test_a_track_outside_its_sigmas_is_an_error_without_a_page(demo, rides, tmp_path, monkeypatch, capsys):
    fuse = verb.compute_wheel_odometry

    def bent(*words, **more):
        """Return the result of odometry with a 5 % scale error."""
        fused = fuse(*words, **more)
        return replace(fused, track=replace(fused.track, x=1.05 * fused.track.x, y=1.05 * fused.track.y))

    monkeypatch.setattr(verb, "compute_wheel_odometry", bent)
    monkeypatch.setattr(verb, "record_drive", lambda *words, **more: rides[0])
    assert main(["demo", "--moving", str(MOVING), "--seed", str(SEED), "-o", str(tmp_path)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "m from the truth at t = " in line and "1 sigma" in line
    assert not list(tmp_path.rglob("index.html"))


def test_the_report_is_beside_the_page_with_the_warnings_of_info(demo):
    assert Path(demo["report"]).parent == Path(demo["page"]).parent
    assert "drive.mcap" in Path(demo["report"]).read_text("utf-8")
    info = json.loads(hubodo("info", demo["log"], "--json").out)
    missing = sum(int(re.search(r": (\d+) samples missing", line)[1]) for line in demo["warnings"])
    assert missing == sum(gap["missing"] for gap in info["gaps"]) + len(info["warnings"])
    assert not any("/odom" in line or "/imu" in line for line in demo["warnings"])


@pytest.mark.repeat
def test_a_second_ride_is_the_first_bit_by_bit(tmp_path):
    scenario = replace(
        make_scenario(SEED, MOVING),
        drive=loop_drive(np.random.default_rng(1), rest_time=1.0, driving_time=1.0),
    )
    logs = []
    for name in ("one", "the_other"):
        (tmp_path / name).mkdir()
        kind = choose_interpreter("auto")
        riders = {"left": scenario.simulated_nodes()["left"]}
        done = record_drive(
            riders, VEHICLE_TOML, tmp_path / name, kind, SEED, lambda share: None, start_ns=10**18
        )
        logs.append(done.log.read_bytes())
    assert logs[0] == logs[1] and len(logs[0]) > 50_000


def test_the_length_it_prints_is_that_of_the_drive(demo, truth):
    length = float(np.sum(np.hypot(*np.diff(truth, axis=0).T)))
    assert demo["true_length"] == pytest.approx(length, abs=1e-3)
    assert demo["fused"]["distance"] == pytest.approx(length, rel=0.01)


def test_the_track_ends_where_the_drive_ends_and_other_methods_do_not(demo, truth):
    track = drawn(Path(demo["page"]).read_text("utf-8"))
    end = truth[-1]
    error = float(np.hypot(*(track[-1] - end)))
    printed = demo["fused"]["truth"]
    print(f"seed {SEED}: ends {error:.3f} m from the truth, {printed['final_error']:.3f} m by its own words")
    # The drawing leaves out points on a straight line, not the last one.
    assert error == pytest.approx(printed["final_error"], abs=2e-3)
    assert error < 0.01 * demo["true_length"]
    tape = float(np.hypot(*(dead_reckoning(demo["log"]) - end)))
    still = float(np.hypot(*truth.T).max())
    print(f"tape measure and bare gyros: {tape:.3f} m; standing still: {still:.3f} m at most")
    assert tape > 5 * error and still > 5 * printed["maximum_error"]


def test_the_track_is_the_path_of_the_drive(demo, truth):
    """Each point of the track is near the true path, and vice versa."""
    track = drawn(Path(demo["page"]).read_text("utf-8"))
    path = truth[::40]
    apart = np.hypot(*(track[:, None, :] - path[None, :, :]).transpose(2, 0, 1))
    assert apart.min(axis=1).max() < 0.01 * demo["true_length"]
    assert apart.min(axis=0).max() < 0.02 * demo["true_length"]
