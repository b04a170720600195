"""Two nodes by Bluetooth to one recorder, with keys, through an outage of the air: every loss is counted."""

import numpy as np
import pytest

from fakes.fake_bluez import FakeBlueZ
from fakes.recorder_thread import RecorderThread
from hubodo.emulator.board.radio_medium import RadioMedium
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host
from hubodo.emulator.chips.ble_link import BleConditions
from hubodo.emulator.chips.ble_peripheral import BleAir, BlePeripheral
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.ingest.link.keys import KeyRing
from hubodo.log.recording_reader import read_recording
from hubowire.ble import WINDOW
from virtual_runs import FIRMWARE, unique_motion
from waiting import until

pytestmark = pytest.mark.real_time

SERIALS = ("e661410300000001", "e661410400000002")
OUTAGE = (3.5, 4.5)
SECONDS = 9


def test_two_nodes_are_recorded_through_an_outage_and_what_it_cost_is_counted(tmp_path, monkeypatch):
    ring = KeyRing(tmp_path / "keys.toml", create=True)
    air = BleAir(BleConditions(interval=0.03, loss=0.02, outages=(OUTAGE,)), seed=3)
    FakeBlueZ(air, monkeypatch)
    medium = RadioMedium(open_bluetooth=lambda mac, platform: BlePeripheral(air, mac, platform))
    nodes = [
        VirtualNode(
            unique_motion(60),
            Flash(FIRMWARE, {"link": "ble", "node_id": k + 1, "key": ring.get_or_create_key(serial).hex()}),
            board=BoardSettings(unique_id=serial, interpreter="cpython", model=("pico_w", "esp32")[k]),
            clock=Clock("paced"),
            host=Host("memory"),
            own_process=False,
            radio_medium=medium,
        )
        for k, serial in enumerate(SERIALS)
    ]
    log = tmp_path / "ble.mcap"
    with nodes[0], nodes[1]:
        ports = ("left=ble://hubodo-1", "right=ble://hubodo-2-0002")
        with RecorderThread(log, *ports, key_file=str(ring.path), wait=True) as recorder:
            until(lambda: min(node.stats["t"] for node in nodes) > SECONDS)
            recorder.stop.set()
            recorder.thread.join(300)
        truths = [node.chip.truth() for node in nodes]
    recording = read_recording(log)
    assert set(recording.nodes) == {"left", "right"}
    assert air.counts["connections lost"] == 2 and air.counts["exchanges lost"] > 10
    for name, truth in zip(("left", "right"), truths, strict=True):
        judge(name, recording, truth)


def judge(name, recording, truth):
    """Check that a node's samples are those of its chip, and that every frame between was counted as lost."""
    rows = indices_in_truth(recording.nodes[name].columns, truth)
    steps = np.diff(rows)
    (gap,) = np.flatnonzero(steps > 1)
    assert np.all(steps >= 1) and truth.t[rows[gap]] == pytest.approx(OUTAGE[0], abs=0.5)
    assert truth.t[rows[gap + 1]] < OUTAGE[1] + 3, "connected again"
    events = [event for event in recording.events if event.source == name]
    lost = [event.data for event in events if event.kind == "gap"]
    assert sum(event["samples_lost"] for event in lost) == steps[gap] - 1
    (break_at,) = [k for k, event in enumerate(events) if event.kind == "disconnected"]
    dropped = [
        [event.data["frames_dropped"] for event in part if event.kind == "health"]
        for part in (events[:break_at], events[break_at:])
    ]
    in_flight = sum(event["frames_lost"] for event in lost) - (dropped[1][-1] - dropped[0][-1])
    assert 0 <= in_flight <= WINDOW


def indices_in_truth(columns, truth):
    """Return the index of each recorded sample among the chip's, all of which differ."""
    gyro = np.column_stack([columns[axis] for axis in ("gx", "gy", "gz")])
    raw = np.rint(gyro / truth.lsb[0, :3]).astype(int)
    known = {tuple(row): k for k, row in enumerate(truth.raw[:, :3].astype(int))}
    return np.array([known[tuple(row)] for row in raw])
