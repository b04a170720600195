"""Live pages of a recording: frames, requests, and that no page delays the recording."""

import asyncio
import json
import socket
import threading
import time
from contextlib import ExitStack
from types import SimpleNamespace

import numpy as np
import pytest
from websockets.sync.client import connect

from fakes.fake_node import FakeNode
from fakes.script import Script
from generators.fake_drive import VEHICLE_TOML, raw_rows, short_drive
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.log.recording_reader import read_recording
from hubodo.log.summary import summarise
from hubodo.vehicle import load_vehicle
from hubodo.web.actions import Actions
from hubodo.web.address import Address
from hubodo.web.app import make_app
from hubodo.web.config import Site
from hubodo.web.hub import HISTORY_FRAMES, FrameHub
from hubodo.web.library import RecordingLibrary
from hubodo.web.live_page import LivePage
from hubodo.web.local_plane import local_east_north
from hubodo.web.request_body import RequestRefused
from hubodo.web.server import serve_in_thread
from hubodo.web.thin_path import ThinnedPath
from hubowire.messages import BiasInit, Reason


@pytest.fixture(scope="module")
def recorded_page(tmp_path_factory):
    """Record with a mark, a refused bias request and a pause: (frames, result, nodes, folder)."""
    folder, frames, computer = tmp_path_factory.mktemp("watched"), [], VirtualComputer()
    (folder / "vehicle.toml").write_text(VEHICLE_TOML)
    page = LivePage(frames.append)
    actions = Actions(page)
    Script(
        computer,
        (2.0, lambda: actions.request_action("mark", {"text": "a  bump\n"})),
        (3.0, lambda: actions.request_action("bias", {"node": "left"})),
        (5.0, lambda: actions.request_action("record", {"on": False})),
        (7.0, lambda: actions.request_action("record", {"on": True})),
    )
    drive = short_drive(5)
    nodes = {
        name: FakeNode(
            node_id=number,
            rows=raw_rows(drive, name),
            bias_q12=(100, 200, 300),
            refuse=Reason.WHEEL_TURNS,
            computer=computer,
        )
        for number, name in ((1, "left"), (2, "right"))
    }
    with nodes["left"] as left, nodes["right"] as right:
        config = RecordConfig(ports=(left.path, right.path), duration=11.0)
        vehicle = load_vehicle(folder / "vehicle.toml")
        result = record(config, folder / "ride.mcap", vehicle=vehicle, computer=computer, audience=page)
    return frames, result, nodes, folder


def test_ten_frames_per_second_hold_the_pose_and_the_wheel_speeds(recorded_page):
    frames, result, _, _ = recorded_page
    assert len(frames) == pytest.approx(110, abs=2)
    last = frames[-1]
    assert last["o"][7] == pytest.approx(result.odometry["distance"], abs=0.1)
    moving = [frame for frame in frames if frame["t"] > 4.0 and frame["t"] < 9.0]
    for frame in moving:
        speeds = [frame["n"][name][1] for name in ("left", "right")]
        assert np.mean(speeds) == pytest.approx(frame["o"][3], abs=0.15)
    assert json.dumps(frames, allow_nan=False)


def test_once_per_second_a_frame_holds_the_state_of_nodes_links_log_and_disk(recorded_page):
    slow = [frame["s"] for frame in recorded_page[0] if "s" in frame]
    assert len(slow) == pytest.approx(11, abs=1)
    left = slow[-1]["nodes"]["left"]
    assert (left["battery"], left["lost"], left["clock"]["source"]) == (3.7, 0, "two way")
    assert left["rate"] == pytest.approx(208, abs=9)
    assert left["bias"]["bias"][2] == pytest.approx(300 / 4096 * np.radians(0.07), abs=1e-6)
    assert left["bias"]["sigma"][1] is None
    assert all(0 < sigma < 0.2 for sigma in left["host_bias"]["sigma"])
    assert slow[-1]["log"]["free"] > 0
    assert slow[-1]["links"][left["link"]]["up"]


def test_a_mark_a_request_and_the_answer_of_the_node_are_events_of_page_and_log(recorded_page):
    frames, _, nodes, folder = recorded_page
    shown = [event for frame in frames for event in frame.get("e", ())]
    recorded = read_recording(folder / "ride.mcap").events
    for events in ([(e["kind"], e["text"]) for e in shown], [(e.kind, e.text) for e in recorded]):
        assert ("mark", "a bump") in events
        assert ("request", "left: bias initialisation over 2000 samples: sent") in events
        refused = next(text for kind, text in events if kind == "answer")
        assert refused.startswith("left: bias initialisation over 2000 samples: refused: the wheel turns")
    assert [m for m in nodes["left"].requests if isinstance(m, BiasInit)] == [BiasInit(2000)]
    assert not [m for m in nodes["right"].requests if isinstance(m, BiasInit)]


def test_a_stop_ends_the_log_and_a_start_begins_another_without_a_gap_on_the_page(recorded_page):
    frames, result, _, folder = recorded_page
    logs = sorted(folder.glob("*.mcap"), key=lambda path: len(path.name))
    assert len(logs) == 2
    spans = []
    for path in logs:
        summary = summarise(path)
        assert summary.complete and not summary.gaps
        recording = read_recording(path)
        spans.append((recording.nodes["left"].t[0], recording.nodes["left"].t[-1]))
        assert recording.metadata["node.left.serial"]
    pause = spans[1][0] + read_recording(logs[1]).t_zero_ns * 1e-9
    pause -= spans[0][1] + read_recording(logs[0]).t_zero_ns * 1e-9
    assert pause == pytest.approx(2.0, abs=0.7)
    assert result.nodes["left"]["samples_lost"] == 0
    messages = sum(stream.messages for path in logs for stream in summarise(path).streams)
    assert messages == result.messages
    states = [frame["s"]["log"]["recording"] for frame in frames if "s" in frame]
    assert states[0] and not states[6] and states[-1]
    assert max(np.diff([frame["t"] for frame in frames])) < 0.25


@pytest.mark.parametrize(
    ("action", "body"),
    [
        ("bias", {"node": "left", "samples": 10}),
        ("bias", {"samples": "many"}),
        ("reboot", {}),
        ("record", {}),
    ],
)
def test_an_invalid_request_is_refused(action, body):
    page = LivePage(lambda frame: None)
    with pytest.raises(RequestRefused):
        Actions(page).request_action(action, body)


def test_the_number_of_waiting_requests_is_limited():
    page = LivePage(lambda frame: None)
    for _ in range(16):
        Actions(page).request_action("mark", {})
    with pytest.raises(RequestRefused, match="too many"):
        Actions(page).request_action("mark", {})


def frame(k):
    return {"t": k * 0.1, "n": {}, "o": [k, 0, 0, 0, 0, 0, 0, 0]}


def test_a_page_opens_with_the_last_minute_and_the_whole_path_and_then_gets_new_frames():
    async def run():
        hub = FrameHub({"version": "1"})
        hub.attach(asyncio.get_running_loop(), csrf="c")
        for k in range(3 * HISTORY_FRAMES):
            hub.put({**frame(k), "e": [{"text": str(k)}]})
            if k % 50 == 0:
                await asyncio.sleep(0)
        await asyncio.sleep(0.01)
        subscription = hub.subscribe()
        first = json.loads(await anext(subscription))
        hub.put(frame(5000))
        next_frame = json.loads(await anext(subscription))
        await subscription.aclose()
        return first, next_frame

    first, next_frame = asyncio.run(run())
    assert first["hello"]["csrf"] == "c"
    assert len(first["history"]) == HISTORY_FRAMES
    assert first["history"][-1]["o"][0] == 3 * HISTORY_FRAMES - 1
    assert first["hello"]["trails"]["o"][0] == [0, 0]
    assert len(first["hello"]["events"]) == 200
    assert next_frame["o"][0] == 5000


def test_a_page_that_reads_slowly_is_reset_instead_of_queueing_its_frames():
    async def run():
        hub = FrameHub({})
        hub.attach(asyncio.get_running_loop())
        subscription = hub.subscribe()
        await anext(subscription)
        for k in range(400):
            hub.put(frame(k))
            await asyncio.sleep(0)
        reset_frame = json.loads(await anext(subscription))
        hub.put(frame(400))
        next_frame = json.loads(await anext(subscription))
        await subscription.aclose()
        return reset_frame, next_frame

    reset_frame, next_frame = asyncio.run(run())
    assert "hello" in reset_frame and len(reset_frame["history"]) == 400
    assert next_frame["o"][0] == 400


def test_a_long_path_is_thinned_and_its_ends_stay():
    trail = ThinnedPath()
    for k in range(100_000):
        trail.add(k * 0.05, 1.0)
    assert 1000 <= len(trail.points) <= 2000
    assert trail.points[0] == [0.0, 1.0]
    assert trail.points[-1][0] > 4990


def test_east_and_north_are_metres_on_the_ground():
    x, y = local_east_north(47.401, 8.502, (47.4, 8.5))
    assert (x, y) == (pytest.approx(151.0, abs=0.3), pytest.approx(111.2, abs=0.2))
    assert local_east_north(0.0, -179.999, (0.0, 179.999))[0] == pytest.approx(222.6, abs=0.2)


def test_a_browser_that_never_reads_delays_neither_the_recording_nor_other_browsers(tmp_path):
    """Frames for such a browser fill the buffers of its socket; further ones are dropped."""
    hub = FrameHub({"pad": "x" * 20_000})
    site = Site(Address("127.0.0.1", 0))
    frames = iter({**frame(k), "pad": "y" * 2000} for k in range(10**9))
    with serve_in_thread(make_app(site, RecordingLibrary(tmp_path), hub), site) as port:
        unread_socket = socket.create_connection(("127.0.0.1", port))
        unread_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        unread_socket.sendall(
            b"GET /live HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
        )
        assert b"101" in unread_socket.recv(12)
        with connect(f"ws://127.0.0.1:{port}/live", max_size=None) as reading_browser:
            reading_browser.recv(timeout=300)
            for _ in range(100):
                for _ in range(30):
                    hub.put(next(frames))
                received = json.loads(reading_browser.recv(timeout=300))
                assert received
            assert len(hub._incoming) <= hub._incoming.maxlen
            assert len(hub._frames) <= HISTORY_FRAMES
        unread_socket.close()


def test_a_port_in_use_is_refused_and_a_stopped_server_releases_its_port(tmp_path):
    site = Site(Address("127.0.0.1", 0))
    with (
        ExitStack() as stack,
        serve_in_thread(make_app(site, RecordingLibrary(tmp_path), FrameHub({})), site) as port,
    ):
        site_in_use = Site(Address("127.0.0.1", port))
        with pytest.raises(Exception, match="cannot listen"), serve_in_thread(None, site_in_use):
            pass
        stack.enter_context(connect(f"ws://127.0.0.1:{port}/live"))
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", port), timeout=2)
    assert "hubodo web" not in {thread.name for thread in threading.enumerate()}


def test_the_age_of_a_snapshot_does_not_depend_on_the_wall_clock(monkeypatch):
    page, elapsed = LivePage(lambda frame: None), iter((100.0, 112.5))
    assert page.now_ns() == 0
    monkeypatch.setattr(time, "monotonic", lambda: next(elapsed))
    page.show(SimpleNamespace(t_ns=5_000_000_000))
    assert page.now_ns() == 17_500_000_000
