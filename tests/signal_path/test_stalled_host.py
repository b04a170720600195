"""A host that keeps the port open but stops reading for ten seconds gets the newest data afterwards."""

import numpy as np

import hubowire
from hubodo.emulator.board.settings import Flash
from hubowire import messages as m
from virtual_runs import (
    FIRMWARE,
    count_missing_frames,
    match_samples,
    messages_of,
    micropython_or_skip,
    unique_motion,
    virtual_node,
)

BEGIN_S, STALL_S, SECONDS = 3.0, 10.0, 17.0
DRIVER_US = 520_000
"""A Pico's USB driver waits for half a second, once, when more is written than fits."""


def test_a_host_that_stops_reading_for_ten_seconds_finds_the_newest_samples_and_the_loss_counted():
    micropython_or_skip()
    # The FIFO, used above 250 Hz and 680 samples deep, covers the wait of the driver.
    deaf = [(BEGIN_S, BEGIN_S + STALL_S)]
    with virtual_node(
        SECONDS, unique_motion(SECONDS), Flash(FIRMWARE, {"rate_hz": 416}), host_pauses=deaf
    ) as node:
        node.wait(100)
        data, arrivals, truth, stats = node.output, node.arrivals(), node.chip.truth(), node.stats
    before = max(count for t, count in arrivals if t < BEGIN_S)
    decoder = hubowire.FrameDecoder()
    sent = [(f, hubowire.decode(f.type_id, f.payload)) for f in decoder.feed(data)]
    health_reports = messages_of(sent, m.Health)
    print(f"{health_reports[-1].frames_dropped} frames dropped, {dict(stats['counts'])}, {decoder.damage}")
    assert stats["resets"] == [] and before > 10_000
    assert (
        health_reports[-1].samples_missed,
        health_reports[-1].fifo_overruns,
        health_reports[-1].faults,
    ) == (0, 0, 0)
    assert stats["counts"]["writes_timed_out"] == 1, "the driver waits for its half second, once"
    assert max(health.worst_loop_us for health in health_reports) < DRIVER_US
    matches = match_samples(sent, truth)
    jump = np.diff(matches[:, 2])
    assert np.array_equal(np.diff(matches[:, 0]), jump), "what is missing is numbered exactly"
    t = truth.t[matches[:, 0].astype(int)]
    assert t[-1] > truth.t[-1] - 0.3, "the newest came"
    at = max(i for i, (_, message) in enumerate(sent) if message is health_reports[-1])
    # At most one frame is cut by the timeout of the driver, and without its delimiter the next is lost too.
    assert decoder.damage.frames <= 1
    assert 0 <= count_missing_frames(sent[: at + 1]) - health_reports[-1].frames_dropped <= 2
    assert health_reports[-1].frames_dropped > 26 * (STALL_S - 5)
