"""The real firmware on a virtual board, unplugged, reset, on a noisy line: all received data is logged."""

import itertools
import threading
import time
from collections import Counter

import numpy as np
import pytest

from hubodo.emulator.board.settings import Flash, Host
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.flash.image import firmware_folder
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.log.hubodo_messages import decode_bytes_message
from hubodo.log.recording_reader import open_log, read_recording
from hubowire import decode
from hubowire.framing import FrameDecoder
from hubowire.messages import Hello, ImuBatch
from virtual_runs import micropython_or_skip
from waiting import until

GYRO_STEP, ACCEL_STEP = np.radians(0.070), 0.488e-3 * 9.80665


def received_frames(node):
    """Return the frames that reached the host, decoded per connection from the noisy bytes."""
    decoder, listening_before = FrameDecoder(), False
    for _, _, noisy, listening in node.link_writes():
        if listening != listening_before:
            decoder, listening_before = FrameDecoder(), listening
        if listening:
            for part in decoder.split_frames(noisy):
                frame = decoder.decode_frame(part)
                if frame is not None:
                    yield part + b"\0", frame


def batches(node):
    return sum(frame.type_id == ImuBatch.type_id for _, frame in received_frames(node))


def boots(node):
    return {
        decode(frame.type_id, frame.payload).boot_id
        for _, frame in received_frames(node)
        if frame.type_id == Hello.type_id
    }


@pytest.mark.timeout(400)  # 12 s on an idle machine
def test_ten_unplugs_one_percent_of_damage_and_a_reset_of_the_real_firmware_are_all_explained(tmp_path):
    micropython_or_skip()
    out, seed = tmp_path / "ride.mcap", 5
    node = VirtualNode(
        StillMotion(),
        Flash(firmware_folder(), {"node_id": 1, "rate_hz": 416, "batch": 8}),
        host=Host(corrupt=0.01, log=True, path=tmp_path / "ttyLEFT"),
        seed=seed,
    )
    stop, results = threading.Event(), []
    with node:
        recorder = threading.Thread(
            target=lambda: results.append(
                record(RecordConfig(ports=(str(node.port),), wait=True), out, stop=stop)
            )
        )
        recorder.start()
        until(lambda: boots(node) and batches(node) > 20)
        for turn in range(10):
            node.unplug()
            time.sleep(0.1)
            node.replug()
            before = batches(node)
            until(lambda: batches(node) >= before + 4)  # noqa: B023 called at once
            if turn == 5:
                node.reset()
                until(lambda: len(boots(node)) == 2)
                before = batches(node)
                until(lambda: batches(node) >= before + 4)  # noqa: B023 called at once
        time.sleep(0.5)
        stop.set()
        recorder.join(300)
        came = [data for data, _ in received_frames(node)]
        truth = node.chip.truth()
    assert results
    with open_log(out) as log:
        logged = [
            decode_bytes_message("cdr", m.data) for m in log.messages() if m.topic == "/hubodo/raw/ttyLEFT"
        ]
    missing = Counter(came) - Counter(logged)
    recording = read_recording(out)
    assert recording.warnings == ()
    by_kind = Counter(event.kind for event in recording.events)
    assert by_kind["reset"] == 1
    assert by_kind["connected"] >= 11
    gaps = [event for event in recording.events if event.kind == "gap" and event.data["stream"] == "ImuBatch"]
    causes = Counter(gap.data["cause"] for gap in gaps)
    print(
        f"seed {seed}: {len(logged)} frames in the log, {len(came)} came, {sum(missing.values())} missing;",
        dict(causes),
    )
    assert causes["node restarted"] == 1
    assert causes["link down"] >= 9
    assert sum(count for cause, count in causes.items() if cause.startswith("damaged bytes")) > 10
    # Data buffered in the port when it was unplugged was not received: a few frames each time.
    assert sum(missing.values()) <= 40, f"seed {seed}"
    # Each recorded sample equals one of the chip.
    table = recording.nodes["left"]
    raw = np.rint(np.hstack([table.gyro / GYRO_STEP, table.accel / ACCEL_STEP])).astype(int)
    raw_rows = {tuple(row) for row in truth.raw.tolist()}
    assert all(tuple(row) in raw_rows for row in raw.tolist())
    assert all(a.t_ns <= b.t_ns for a, b in itertools.pairwise(gaps))
