"""Links that take less than the node has: the oldest frames go, counted; no sample does; no turn is long."""

import numpy as np
import pytest

from hubodo.emulator.board.settings import BoardSettings
from hubowire import messages as m
from virtual_runs import all_lost, matched, of, run

MODEL = {"rp2": "pico", "esp32": "esp32"}
LONGEST_US = 8000
"""What a turn may take with all that is done once a second in it; a sample at 104 Hz comes every 9600 us."""

SLOW = [
    # port, link, rate, settings: what the link carries is below what the node has, but for the last.
    ("rp2", "uart", 104, {"baud": 9600}),
    ("rp2", "uart", 208, {"baud": 19200}),
    ("esp32", "uart", 208, {"baud": 19200}),
    ("esp32", "uart", 1660, {"baud": 115200}),
    ("esp32", "usb", 1660, {}),
    ("esp32", "usb", 416, {}),
]


@pytest.mark.parametrize(("port", "link", "rate", "config"), SLOW)
def test_a_slow_link_costs_the_oldest_frames_and_neither_samples_nor_time(port, link, rate, config):
    uart = {"rp2": 0, "esp32": 2}[port] if link == "uart" else None
    config = {"link": link, "rate_hz": rate, **config}
    sent, truth, stats = run(10, board=BoardSettings(model=MODEL[port], uart_link=uart), config=config)
    rows = matched(sent, truth)
    missing, jump = np.diff(rows[:, 0]) - 1, np.diff(rows[:, 2]) - 1
    assert np.array_equal(missing, jump), "what did not come is numbered exactly"
    reports = of(sent, m.Health)
    assert len(reports) >= 1 and stats["resets"] == []
    assert (reports[-1].samples_missed, reports[-1].fifo_overruns, reports[-1].faults) == (0, 0, 0)
    # In the first turn of all the first sample is waited for.
    assert max(health.worst_loop_us for health in reports[1:]) < LONGEST_US
    too_much = (port, link, rate) != ("esp32", "usb", 416)
    at = max(i for i, (_, message) in enumerate(sent) if message is reports[-1])
    assert 0 <= all_lost(sent[: at + 1]) - reports[-1].frames_dropped <= 24, "those that went while it waited"
    assert (reports[-1].frames_dropped > 0) == too_much and missing.any() == too_much
    waits_s = 24 * 250 * 10 / config.get("baud", 115200) if too_much else 0.2
    assert truth.t[int(rows[-1, 0])] > 10 - waits_s, "nothing waits longer than a full queue takes"
