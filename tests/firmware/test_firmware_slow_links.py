"""Links slower than the node: the oldest frames are dropped and counted, sampling continues."""

import numpy as np
import pytest

from hubodo.emulator.board.settings import BoardSettings
from hubowire import messages as m
from repetitions import first_and_more
from virtual_runs import count_missing_frames, match_samples, messages_of, run

MODEL = {"rp2": "pico", "esp32": "esp32"}
MAX_LOOP_US = 8000
"""Limit of one loop, including tasks of once per second; samples at 104 Hz come every 9600 us."""

LINKS = [
    # port, link, rate, settings: the link is too slow for the node, except USB for 416 Hz.
    ("rp2", "uart", 104, {"baud": 9600}),
    ("esp32", "usb", 416, {}),
    *first_and_more(
        ("esp32", "usb", 1660, {}),
        ("rp2", "uart", 208, {"baud": 19200}),
        ("esp32", "uart", 208, {"baud": 19200}),
        ("esp32", "uart", 1660, {"baud": 115200}),
    ),
]


@pytest.mark.parametrize(("port", "link", "rate", "config"), LINKS)
def test_a_slow_link_drops_the_oldest_frames_and_delays_no_sample(port, link, rate, config):
    uart = {"rp2": 0, "esp32": 2}[port] if link == "uart" else None
    config = {"link": link, "rate_hz": rate, **config}
    sent, truth, stats = run(10, board=BoardSettings(model=MODEL[port], uart_link=uart), config=config)
    rows = match_samples(sent, truth)
    missing, jump = np.diff(rows[:, 0]) - 1, np.diff(rows[:, 2]) - 1
    assert np.array_equal(missing, jump), "the numbers show the missing samples exactly"
    reports = messages_of(sent, m.Health)
    assert len(reports) >= 1 and stats["resets"] == []
    assert (reports[-1].samples_missed, reports[-1].fifo_overruns, reports[-1].faults) == (0, 0, 0)
    # The first loop waits for the first sample.
    assert max(health.worst_loop_us for health in reports[1:]) < MAX_LOOP_US
    is_too_slow = (port, link, rate) != ("esp32", "usb", 416)
    at = max(i for i, (_, message) in enumerate(sent) if message is reports[-1])
    assert 0 <= count_missing_frames(sent[: at + 1]) - reports[-1].frames_dropped <= 24, (
        "frames dropped while the report waited"
    )
    assert (reports[-1].frames_dropped > 0) == is_too_slow and missing.any() == is_too_slow
    waits_s = 24 * 250 * 10 / config.get("baud", 115200) if is_too_slow else 0.2
    assert truth.t[int(rows[-1, 0])] > 10 - waits_s, "no frame waits longer than a full queue lasts"
