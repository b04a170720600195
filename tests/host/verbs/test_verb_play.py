"""`hubodo play`: recordings are replayed frame by frame, imports within their quantisation steps."""

import itertools
import json
import os
import threading
import time

import numpy as np
import pytest

from fakes.fake_node import FakeNode
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.ingest.replay.log_frames import raw_links, recorded_frames, synthesise_frames
from hubodo.ingest.replay.pty_player import PtyPlayer
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table
from hubowire.messages import Ack, Nack, TimeReply
from in_process import hubodo


def replay(frames, out, *, speed=1.0, seconds, link=None):
    """Replay frames into a recorder; return its result, its recording and the player."""
    with PtyPlayer(link, speed) as player:
        done = threading.Event()

        def play():
            player.play(frames, done.is_set, lambda t: None)
            time.sleep(0.2)
            done.set()

        thread = threading.Thread(target=play)
        thread.start()
        result = record(RecordConfig(ports=(player.path,), duration=seconds), out, stop=done)
        done.set()
        thread.join(10)
    return result, read_recording(out), player


@pytest.fixture(scope="module")
def ride(tmp_path_factory):
    """Record one fake node for 2 s with damaged bytes on its line."""
    out, computer = tmp_path_factory.mktemp("ride") / "ride.mcap", VirtualComputer()
    with FakeNode(node_id=1, damage=0.0005, seed=3, computer=computer) as node:
        record(RecordConfig(ports=(f"left={node.path}",), duration=2.0), out, computer=computer)
    return out


def all_frames(path):
    with open_log(path) as log:
        return list(recorded_frames(log, raw_links(log), log.t_zero_ns, None, None))


def test_a_recording_played_to_a_port_is_recorded_again_sample_for_sample(ride, tmp_path):
    original = read_recording(ride).nodes["left"]
    result, again, player = replay(all_frames(ride), tmp_path / "again.mcap", seconds=6)
    table = again.nodes["left"]
    assert player.undelivered == 0
    np.testing.assert_array_equal(table.gyro, original.gyro)
    np.testing.assert_array_equal(table.accel, original.accel)
    # The sample intervals are preserved, because the replayed clock answers use the same device times.
    np.testing.assert_allclose(table.t - table.t[0], original.t - original.t[0], atol=5e-3)
    assert result.nodes["left"]["clock"]["source"] == "two way"


def test_damaged_bytes_are_replayed_and_answers_to_the_old_host_are_left_out(ride):
    frames = all_frames(ride)
    assert any(item.frame is None for item in frames)
    assert all(
        item.frame.type_id not in (Ack.type_id, Nack.type_id, TimeReply.type_id)
        for item in frames
        if item.frame
    )
    assert all(a.t <= b.t for a, b in itertools.pairwise(frames))


def test_replay_at_full_speed_loses_nothing(ride, tmp_path):
    original = read_recording(ride).nodes["left"]
    _, again, _ = replay(all_frames(ride), tmp_path / "again.mcap", speed=0.0, seconds=6)
    np.testing.assert_array_equal(again.nodes["left"].gyro, original.gyro)


def write_import(tmp_path, names=("left", "pole"), uneven=False):
    rng = np.random.default_rng(5)
    tables = {}
    for name in names:
        t = 3.0 + np.arange(200) / 200.0
        if uneven:
            t = t + rng.uniform(-1e-3, 1e-3, len(t))
        columns = {"t": t}
        for axis in ("gx", "gy", "gz"):
            columns[axis] = rng.normal(0, 3, len(t))
        for axis in ("ax", "ay", "az"):
            columns[axis] = rng.normal(0, 9, len(t))
        tables[name] = Table(columns)
    path = tmp_path / "import.mcap"
    write_recording(Recording(nodes=tables), path)
    return read_recording(path), path


@pytest.mark.parametrize("uneven", [False, True])
def test_an_import_is_replayed_within_half_a_step_and_the_reported_time_error(tmp_path, uneven):
    recording, _ = write_import(tmp_path, uneven=uneven)
    frames, quantisation = synthesise_frames(recording, None, None)
    _, again, _ = replay(frames, tmp_path / "again.mcap", seconds=5)
    assert [q.node_id for q in quantisation] == [1, 4]
    for q, name in zip(quantisation, ("left", "node4"), strict=True):
        original, table = recording.nodes[q.node], again.nodes[name]
        assert not q.has_temperature
        assert np.abs(table.gyro - original.gyro).max() <= 0.5 * q.gyro_step * (1 + 1e-9)
        assert np.abs(table.accel - original.accel).max() <= 0.5 * q.accel_step * (1 + 1e-9)
        assert q.gyro_step < 2 * np.abs(original.gyro).max() / 32767
        assert q.time_error <= 20.5e-6 + 1e-6


def test_start_and_end_select_a_part(ride):
    with open_log(ride) as log:
        frames = list(recorded_frames(log, raw_links(log), log.t_zero_ns, 1.0, 1.5))
    assert frames
    assert all(1.0 <= item.t < 1.5 for item in frames)


def test_playing_without_waiting_ends_with_a_result(ride):
    done = hubodo("play", ride, "--speed", "0", "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["frames"] is None


def test_a_symlink_leads_to_the_port_while_playing(tmp_path):
    link = tmp_path / "ttyRIDE"
    with PtyPlayer(link, 1.0) as player:
        assert player.path == str(link)
        assert os.path.exists(link)  # noqa: PTH110 follows the link
    assert not link.is_symlink()


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--speed", "-1"), "--speed"),
        (("--speed", "nan"), "--speed"),
        (("--start", "5", "--end", "2"), "not after"),
        (("--link", "/tmp/x"), "--to pty"),
        (("--to", "pty", "--only", "rear"), "no frames of link 'rear'; there are left"),
    ],
)
def test_invalid_options_are_refused_in_one_line(ride, args, message):
    done = hubodo("play", ride, *args)
    assert done.code == 2
    assert message in done.err
    assert len(done.err.strip().splitlines()) == 1


def test_a_file_that_is_not_a_log_is_refused(tmp_path):
    path = tmp_path / "x.mcap"
    path.write_bytes(b"not a log")
    done = hubodo("play", path)
    assert done.code == 2
    assert len(done.err.strip().splitlines()) == 1
