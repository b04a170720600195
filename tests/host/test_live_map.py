"""Odometry and a GNSS receiver while recording: where on the map, beside an odometry that is not held up."""

import itertools
import json
import pickle
import threading
import time

import numpy as np
import pytest

from fakes.fake_node import FakeNode
from fakes.fake_receiver import fake_receiver
from fakes.script import Script
from generators.fake_drive import VEHICLE_TOML, raw_rows, short_drive
from generators.gnss_drives import WGS84, geodetic
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.records import Pose
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.localizer import FixSample, Localizer
from hubodo.ingest.live.localizer_thread import LocalizerThread
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.ingest.replay.playback import Playback, recorded_messages, to_messages
from hubodo.log import topics
from hubodo.log.recording_reader import open_log, read_recording
from in_process import hubodo

SEED = 6
ORIGIN = (47.37, 8.54)
START_HEADING = 2.0
"""rad from east at which the drive begins; the odometry begins at 0."""


def place_on(drive, since, noise):
    """East, north of the drive's start after so many s."""
    way = np.interp(since, drive.t, drive.x) + 1j * np.interp(since, drive.t, drive.y)
    way = way * np.exp(1j * START_HEADING) + complex(*noise)
    return np.array([way.real]), np.array([way.imag])


@pytest.fixture(scope="module")
def ride(tmp_path_factory):
    """(log, JSON result, drive) of eleven seconds; the graph does not move before the last but one."""
    folder = tmp_path_factory.mktemp("ride")
    (folder / "vehicle.toml").write_text(VEHICLE_TOML)
    drive, out = short_drive(SEED), folder / "ride.mcap"
    rng, computer, moving = np.random.default_rng(SEED), VirtualComputer(), threading.Event()
    Script(computer, (10.0, moving.set))
    move = Localizer.add_fix

    def stands_still(localizer, fix):
        assert moving.wait(60), "the recorder waits for the graph"
        move(localizer, fix)

    def place(since):
        latitude, longitude = geodetic(*place_on(drive, since, 0.2 * rng.standard_normal(2)), *ORIGIN)
        return float(latitude[0]), float(longitude[0]), 0.2

    with (
        pytest.MonkeyPatch.context() as patch,
        FakeNode(node_id=1, rows=raw_rows(drive, "left"), computer=computer) as left,
        FakeNode(node_id=2, rows=raw_rows(drive, "right"), computer=computer) as right,
        fake_receiver(computer, place) as receiver,
    ):
        patch.setattr(Localizer, "add_fix", stands_still)
        done = hubodo(
            "record", f"left={left.path}", f"right={right.path}", "--gnss", receiver.path,
            "--vehicle", folder / "vehicle.toml", "--duration", 11, "-o", out, "--json",
            computer=computer,
        )  # fmt: skip
    assert done.code == 0, done.err
    return out, json.loads(done.out), drive


def test_the_map_is_found_and_its_latency_is_told(ride):
    _, result, drive = ride
    found = result["map"]
    assert found["poses"] > 20
    assert 0.0 < found["latency_median"] <= found["latency_p99"] <= found["latency_worst"]
    assert 0.0 < found["sigma"] < 1.0
    latitude, longitude = geodetic(*place_on(drive, drive.t[-1], (0.0, 0.0)), *ORIGIN)
    azimuth, _, far = WGS84.inv(found["longitude_deg"], found["latitude_deg"], longitude[0], latitude[0])
    east, north = far * np.sin(np.radians(azimuth)), far * np.cos(np.radians(azimuth))
    assert np.hypot(found["x"] - east, found["y"] - north) < 4.0 * found["sigma"] + 0.2, f"seed {SEED}"
    turned = found["heading"] - (START_HEADING + drive.heading[-1])
    assert np.angle(np.exp(1j * turned)) == pytest.approx(0.0, abs=0.15)


def test_the_odometry_is_not_held_up_by_the_graph(ride):
    _, result, _ = ride
    assert result["odometry"]["latency_worst"] < 0.02
    assert result["map"]["latency_worst"] > 1.0


def test_map_to_odom_after_odom_to_base_link_is_where_the_vehicle_is_on_the_map(ride):
    """REP 105: the chain of the two transforms on /tf against /odom_map."""
    out, _, _ = ride
    publications = list(Playback(out).publications())
    located = [made for made in publications if hasattr(made, "odom_heading")]
    odom = read_recording(out).odometry
    t = np.array([int(made.t_ns[0]) for made in located])
    recording_zero = Playback(out).t_zero_ns
    seconds = (t - recording_zero) * 1e-9
    inside = seconds < odom.t[-1]
    x, y = (np.interp(seconds, odom.t, odom[name]) for name in ("x", "y"))
    apart = [
        np.hypot(*(made.odom_position[0] + _turned(ox, oy, made.odom_heading[0]) - made.position[0]))
        for made, ox, oy in zip(np.array(located)[inside], x[inside], y[inside], strict=True)
    ]
    # /odom's rows lie within a few ms of the end of a window, and are carried there from the one before.
    assert len(apart) > 20 and max(apart) < 0.03


def _turned(x, y, angle):
    place = (x + 1j * y) * np.exp(1j * angle)
    return np.array([place.real, place.imag])


def test_the_log_alone_gives_odometry_and_map_again_to_the_last_bit(ride):
    out, result, _ = ride
    playback = Playback(out)
    recorded = recorded_messages(out)
    assert to_messages(playback.publications(), playback.t_zero_ns) == recorded
    assert len(recorded[topics.ODOM_MAP]) == result["map"]["poses"]
    shown = json.loads(hubodo("play", out, "--speed", 0, "--json").out)["odometry"]
    assert shown["equal"] is True
    assert shown["located"] == result["map"]["poses"]


def test_the_origin_of_the_map_is_in_the_log(ride):
    out, result, _ = ride
    origins = [event.data for event in read_recording(out).events if event.source == "map"]
    assert origins == [
        {"latitude_deg": result["map"]["latitude_deg"], "longitude_deg": result["map"]["longitude_deg"]}
    ]
    with open_log(out) as log:
        frames = {message.data[16:24] for message in log.messages(["/tf"])}
    assert len(frames) == 2


def steps(seconds=40.0, heading=0.0, drift=0.0):
    """Poses and fixes of a straight way at 1 m/s to a heading on the map, by time; no noise."""
    items = []
    for k in range(1, int(10 * seconds)):
        t = 0.1 * k
        items.append(Pose(t, t, 0.0, 0.0, 1.0, 0.0, np.eye(5), MotionState.MOVING, 0.0, 0))
        if k % 2 == 0:
            way = t * np.exp(1j * heading)
            latitude, longitude = geodetic(np.array([way.real]), np.array([way.imag]), *ORIGIN)
            items.append(FixSample(round(t * 1e9), float(latitude[0]), float(longitude[0]), 0.5))
    return items


def test_a_straight_way_has_the_heading_of_its_fixes():
    localizer, last = Localizer(0), None
    for item in steps(heading=0.7):
        last = localizer.add_fix(item) or last if isinstance(item, FixSample) else localizer.add_pose(item)
    assert last.odom_heading[0] == pytest.approx(0.7, abs=0.03)
    assert localizer.warnings() == []


def test_the_thread_gives_the_bits_of_the_object_and_ends_with_its_input():
    localizer, found, got = Localizer(0), [], []
    thread = LocalizerThread(0, got.append, bulkheads=Bulkheads(time.time_ns))
    for number, item in enumerate(steps(20.0)):
        thread.put(item, number)
        made = localizer.add_fix(item) if isinstance(item, FixSample) else localizer.add_pose(item)
        if made is not None:
            found.append((number, made))
    assert thread.close()
    assert len(got) == len(found) > 50
    for answer, (number, made) in zip(got, found, strict=True):
        assert answer.arrived_ns == number
        assert pickle.dumps(answer.pose) == pickle.dumps(made)
    assert not any(thread.name == "map" for thread in threading.enumerate())


def test_a_thread_that_is_stopped_leaves_what_it_was_given():
    got = []
    thread = LocalizerThread(0, got.append, bulkheads=Bulkheads(time.time_ns))
    for item in steps(40.0):
        thread.put(item, 0)
    thread.stop()
    assert thread.close()
    assert len(got) < 300


def test_a_graph_that_fails_is_reported_and_replaced_by_one_in_the_same_map_frame(monkeypatch):
    fix, left = Localizer.add_fix, [len(steps(20.0)) // 3]

    def fails_once(self, sample):
        left[0] -= 1
        if left[0] == 0:
            raise ValueError("indeterminate system")
        fix(self, sample)

    monkeypatch.setattr(Localizer, "add_fix", fails_once)
    minutes = itertools.count(step=60_000_000_000)  # so that no pause lasts until the next item
    got, bulkheads = [], Bulkheads(lambda: next(minutes))
    thread = LocalizerThread(0, got.append, bulkheads=bulkheads)
    for item in steps(60.0):
        thread.put(item, 0)
    assert thread.close()
    assert bulkheads.fault_counts() == {"map": 1}
    assert "indeterminate system" in bulkheads.due_reports()[0].text
    located = [answer.pose for answer in got if answer.pose is not None]
    assert len({item.origin_deg for item in located}) == 1
    assert located[-1].t_ns[0] > 59e9
    ahead = [item.position[0, 0] - item.t_ns[0] * 1e-9 for item in located]
    assert np.ptp(ahead) < 1.0, "at 1 m/s it goes on where it was, 1 s of pause included"
