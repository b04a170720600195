"""Recording with a GNSS receiver: position on the map, without delaying the odometry."""

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
MAX_SECONDS = 300.0  # until the queue of a thread is empty, on a busy computer
ORIGIN = (47.37, 8.54)
START_HEADING = 2.0
"""Heading of the vehicle on the map at the start, in rad from east; odometry headings start at 0."""


def true_position(drive, since, noise):
    """Return the true position `since` s after the start: m east and north of the start."""
    position = np.interp(since, drive.t, drive.x) + 1j * np.interp(since, drive.t, drive.y)
    position = position * np.exp(1j * START_HEADING) + complex(*noise)
    return np.array([position.real]), np.array([position.imag])


@pytest.fixture(scope="module")
def ride(tmp_path_factory):
    """Record eleven seconds: (log, JSON result, drive); the graph is blocked until 10 s have passed."""
    folder = tmp_path_factory.mktemp("ride")
    (folder / "vehicle.toml").write_text(VEHICLE_TOML)
    drive, out = short_drive(SEED), folder / "ride.mcap"
    rng, computer, unblocked = np.random.default_rng(SEED), VirtualComputer(), threading.Event()
    Script(computer, (10.0, unblocked.set))
    add_fix = Localizer.add_fix

    def blocked_add_fix(localizer, fix):
        assert unblocked.wait(60), "the recorder waited for the graph"
        add_fix(localizer, fix)

    def measured_fix(since):
        latitude, longitude = geodetic(*true_position(drive, since, 0.2 * rng.standard_normal(2)), *ORIGIN)
        return float(latitude[0]), float(longitude[0]), 0.2

    with (
        pytest.MonkeyPatch.context() as patch,
        FakeNode(node_id=1, rows=raw_rows(drive, "left"), computer=computer) as left,
        FakeNode(node_id=2, rows=raw_rows(drive, "right"), computer=computer) as right,
        fake_receiver(computer, measured_fix) as receiver,
    ):
        patch.setattr(Localizer, "add_fix", blocked_add_fix)
        done = hubodo(
            "record", f"left={left.path}", f"right={right.path}", "--gnss", receiver.path,
            "--vehicle", folder / "vehicle.toml", "--duration", 11, "-o", out, "--json",
            computer=computer,
        )  # fmt: skip
    assert done.code == 0, done.err
    return out, json.loads(done.out), drive


def test_the_position_on_the_map_is_estimated_and_its_latency_reported(ride):
    _, result, drive = ride
    map_result = result["map"]
    assert map_result["poses"] > 20
    assert 0.0 < map_result["latency_median"] <= map_result["latency_p99"] <= map_result["latency_worst"]
    assert 0.0 < map_result["sigma"] < 1.0
    latitude, longitude = geodetic(*true_position(drive, drive.t[-1], (0.0, 0.0)), *ORIGIN)
    azimuth, _, distance = WGS84.inv(
        map_result["longitude_deg"], map_result["latitude_deg"], longitude[0], latitude[0]
    )
    east, north = distance * np.sin(np.radians(azimuth)), distance * np.cos(np.radians(azimuth))
    assert np.hypot(map_result["x"] - east, map_result["y"] - north) < 4.0 * map_result["sigma"] + 0.2, (
        f"seed {SEED}"
    )
    heading_error = map_result["heading"] - (START_HEADING + drive.heading[-1])
    assert np.angle(np.exp(1j * heading_error)) == pytest.approx(0.0, abs=0.15)


def test_a_slow_graph_does_not_delay_the_odometry(ride):
    _, result, _ = ride
    assert result["odometry"]["latency_worst"] < 0.02
    assert result["map"]["latency_worst"] > 1.0


def test_map_to_odom_and_odom_to_base_link_chain_to_the_position_on_the_map(ride):
    """Compare the chain of the two transforms on /tf (REP 105) with /odom_map."""
    out, _, _ = ride
    publications = list(Playback(out).publications())
    located = [publication for publication in publications if hasattr(publication, "odom_heading")]
    odom = read_recording(out).odometry
    t = np.array([int(publication.t_ns[0]) for publication in located])
    recording_zero = Playback(out).t_zero_ns
    seconds = (t - recording_zero) * 1e-9
    in_odometry = seconds < odom.t[-1]
    x, y = (np.interp(seconds, odom.t, odom[name]) for name in ("x", "y"))
    differences = [
        np.hypot(
            *(
                publication.odom_position[0]
                + _rotated(ox, oy, publication.odom_heading[0])
                - publication.row.position[0]
            )
        )
        for publication, ox, oy in zip(
            np.array(located)[in_odometry], x[in_odometry], y[in_odometry], strict=True
        )
    ]
    # Rows of /odom lie within a few ms of a window end, propagated from the previous window.
    assert len(differences) > 20 and max(differences) < 0.03


def _rotated(x, y, angle):
    position = (x + 1j * y) * np.exp(1j * angle)
    return np.array([position.real, position.imag])


def test_playback_reproduces_odometry_and_map_bit_by_bit(ride):
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


def straight_drive(seconds=40.0, heading=0.0, drift=0.0):
    """Return noise-free poses and fixes, by time, of a straight drive at 1 m/s with a heading on the map."""
    items = []
    for k in range(1, int(10 * seconds)):
        t = 0.1 * k
        items.append(Pose(t, t, 0.0, 0.0, 1.0, 0.0, np.eye(5), MotionState.MOVING, 0.0, 0))
        if k % 2 == 0:
            position = t * np.exp(1j * heading)
            latitude, longitude = geodetic(np.array([position.real]), np.array([position.imag]), *ORIGIN)
            items.append(FixSample(round(t * 1e9), float(latitude[0]), float(longitude[0]), 0.5))
    return items


def test_a_straight_drive_has_the_heading_of_its_fixes():
    localizer, last = Localizer(0), None
    for item in straight_drive(heading=0.7):
        last = localizer.add_fix(item) or last if isinstance(item, FixSample) else localizer.add_pose(item)
    assert last.odom_heading[0] == pytest.approx(0.7, abs=0.03)
    assert localizer.warnings() == []


def test_sigma_after_an_outage_of_a_minute_is_that_of_headings_from_gyros():
    """Straight on at 5 m/s, a minute with fixes of 1.5 m at 1 Hz and a minute without.

    Place, heading, radius and a constant yaw rate make 3.7 m 300 m later (1σ); a track that unequal radii may
    bend would make 7.0 m.
    """
    localizer, last, rng = Localizer(0), None, np.random.default_rng(SEED)
    for k in range(1, 1200):
        t = 0.1 * k
        last = localizer.add_pose(Pose(t, 5.0 * t, 0.0, 0.0, 5.0, 0.0, np.eye(5), MotionState.MOVING, 0.0, 0))
        if k % 10 == 0 and t <= 60.0:
            east, north = 5.0 * t + 1.5 * rng.standard_normal(), 1.5 * rng.standard_normal()
            latitude, longitude = geodetic(east, north, *ORIGIN)
            localizer.add_fix(FixSample(round(t * 1e9), float(latitude), float(longitude), 1.5))
    sigma = np.sqrt(np.trace(last.row.pose_covariance[0][:2, :2]))
    azimuth, _, distance = WGS84.inv(ORIGIN[1], ORIGIN[0], *last.origin_deg[::-1])
    origin = distance * np.exp(1j * (np.pi / 2 - np.radians(azimuth)))
    error = complex(*last.row.position[0]) + origin - 5.0 * 119.9
    assert 2.0 < sigma < 5.0
    assert abs(error) < 3.0 * sigma, f"seed {SEED}"


def test_map_to_odom_contains_the_correction_that_odom_has_not_followed_yet():
    """/odom lags by 0.3 m and 0.1 rad; chained with map → odom it still gives the pose on the map."""
    plain, lagging = Localizer(0), Localizer(0)
    published = (0.1, -0.3, -0.1)
    for item in straight_drive(20.0, heading=0.7):
        if isinstance(item, FixSample):
            plain.add_fix(item)
            lagging.add_fix(item)
            continue
        odom = tuple(value + offset for value, offset in zip(item[1:4], published, strict=True))
        expected, located = plain.add_pose(item), lagging.add_pose(item._replace(published=odom))
    np.testing.assert_array_equal(located.row.position, expected.row.position)
    assert located.row.heading == pytest.approx(expected.row.heading)
    chained = located.odom_position[0] + _rotated(*odom[:2], located.odom_heading[0])
    np.testing.assert_allclose(chained, located.row.position[0], atol=1e-9)
    assert located.odom_heading[0] + odom[2] == pytest.approx(located.row.heading[0])
    assert np.hypot(*(located.odom_position - expected.odom_position)[0]) > 0.2


def test_the_thread_returns_the_poses_of_the_localizer_bit_by_bit_and_ends_with_its_input():
    localizer, expected, answers = Localizer(0), [], []
    thread = LocalizerThread(0, answers.append, bulkheads=Bulkheads(time.time_ns))
    for number, item in enumerate(straight_drive(20.0)):
        thread.put(item, number)
        pose = localizer.add_fix(item) if isinstance(item, FixSample) else localizer.add_pose(item)
        if pose is not None:
            expected.append((number, pose))
    assert thread.close(MAX_SECONDS)
    assert len(answers) == len(expected) > 50
    for answer, (number, pose) in zip(answers, expected, strict=True):
        assert answer.arrived_ns == number
        assert pickle.dumps(answer.pose) == pickle.dumps(pose)
    assert not any(thread.name == "map" for thread in threading.enumerate())


def test_a_stopped_thread_drops_its_queue():
    answers = []
    thread = LocalizerThread(0, answers.append, bulkheads=Bulkheads(time.time_ns))
    for item in straight_drive(40.0):
        thread.put(item, 0)
    thread.stop()
    assert thread.close(MAX_SECONDS)
    assert len(answers) < 300


def test_a_graph_that_fails_is_reported_and_replaced_by_one_in_the_same_map_frame(monkeypatch):
    add_fix, calls_left = Localizer.add_fix, [len(straight_drive(20.0)) // 3]

    def fails_once(self, sample):
        calls_left[0] -= 1
        if calls_left[0] == 0:
            raise ValueError("indeterminate system")
        add_fix(self, sample)

    monkeypatch.setattr(Localizer, "add_fix", fails_once)
    minutes = itertools.count(step=60_000_000_000)  # so that no pause lasts until the next item
    answers, bulkheads = [], Bulkheads(lambda: next(minutes))
    thread = LocalizerThread(0, answers.append, bulkheads=bulkheads)
    for item in straight_drive(60.0):
        thread.put(item, 0)
    assert thread.close(MAX_SECONDS)
    assert bulkheads.fault_counts() == {"map": 1}
    assert "indeterminate system" in bulkheads.due_reports()[0].text
    located = [answer.pose for answer in answers if answer.pose is not None]
    assert len({item.origin_deg for item in located}) == 1
    assert located[-1].t_ns[0] > 59e9
    ahead = [item.row.position[0, 0] - item.t_ns[0] * 1e-9 for item in located]
    assert np.ptp(ahead) < 1.0, "at 1 m/s the new graph may be behind by 1 m, for a pause of 1 s"
