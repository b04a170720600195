"""Wi-Fi outages on both ports: the node reconnects, finds the host again, and loses no sample."""

import socket
import threading

import numpy as np
import pytest

import hubowire
from hubodo.emulator.board.network import WifiEnvironment
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host
from hubodo.emulator.virtual_node import VirtualNode
from hubowire import messages as m
from repetitions import each_value_first, first_and_more
from virtual_runs import (
    FIRMWARE,
    count_missing_frames,
    match_samples,
    messages_of,
    micropython_or_skip,
    unique_motion,
)

PORTS = ["rp2", "esp32"]
RATE_HZ = 104
QUEUE_S = 24 * 8 / RATE_HZ
"""Samples that the node queues while disconnected: 24 frames of 8."""
MAX_LOOP_US = 80_000
"""Limit of one loop; a join blocks the processor of the virtual board for 50 ms."""


class Listener:
    """A UDP socket of the host that is read continuously."""

    def __init__(self, address="127.0.0.1", port=0):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self.socket.bind((address, port))
        self.port = self.socket.getsockname()[1]
        self.datagrams = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        while data := self.socket.recv(2048):
            self.datagrams.append(data)

    def stop(self):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as last:
            last.sendto(b"", self.socket.getsockname())
        self._thread.join(5)
        self.socket.close()
        frames = [f for data in self.datagrams for f in hubowire.FrameDecoder().feed(data)]
        return [(f, hubowire.decode(f.type_id, f.payload)) for f in frames]


def run_node(seconds, port, air, *, host="127.0.0.1", listeners=("127.0.0.1",), interpreter="micropython"):
    """Run a node; return the messages of each listener, the truth and the statistics of the board."""
    if interpreter == "micropython":
        micropython_or_skip()
    listeners_ = [Listener(listeners[0])]
    listeners_ += [Listener(address, listeners_[0].port) for address in listeners[1:]]
    config = {
        "link": "udp",
        "ssid": "net",
        "host": host,
        "port": listeners_[0].port,
        "mag_rate_hz": 0,
        "rate_hz": RATE_HZ,
    }
    node = VirtualNode(
        unique_motion(seconds),
        Flash(FIRMWARE, config),
        board=BoardSettings(model="pico_w" if port == "rp2" else "esp32", wifi=air, interpreter=interpreter),
        clock=Clock("stepped", run_for=seconds),
        host=Host("memory"),
        own_process=False,
    )
    with node:
        node.wait(100)
        truth, stats = node.chip.truth(), node.stats
    return [listener.stop() for listener in listeners_], truth, stats


def check_and_get_times(sent, truth, stats):
    """Check that only counted frames were lost and no loop was long; return the times received in s."""
    assert stats["resets"] == [] and stats["counts"].get("at_prompt", 0) == 0
    reports = messages_of(sent, m.Health)
    assert (reports[-1].samples_missed, reports[-1].fifo_overruns, reports[-1].faults) == (0, 0, 0)
    assert max(health.worst_loop_us for health in reports) < MAX_LOOP_US
    rows = match_samples(sent, truth)
    assert np.array_equal(np.diff(rows[:, 0]), np.diff(rows[:, 2])), "the numbers show the missing samples"
    at = max(i for i, (_, message) in enumerate(sent) if message is reports[-1])
    assert 0 <= count_missing_frames(sent[: at + 1], since_boot=True) - reports[-1].frames_dropped <= 24
    return truth.t[rows[:, 0].astype(int)]


@pytest.mark.parametrize("port", first_and_more(*PORTS))
def test_a_late_network_gets_the_newest_samples(port):
    (sent,), truth, stats = run_node(30, port, WifiEnvironment(outages=((0, 12),), join_time=2.0))
    t = check_and_get_times(sent, truth, stats)
    assert 12 - QUEUE_S < t[0] < 12 + 8 + 2 + 2, "pauses between attempts are 1, 2, 4 and 8 s"
    assert t[-1] > 29.5


@pytest.mark.parametrize(
    ("port", "interpreter"),
    [
        ("rp2", "micropython"),
        *first_and_more(("esp32", "cpython"), ("esp32", "micropython"), ("rp2", "cpython")),
    ],
)
def test_after_an_outage_the_node_reconnects_and_only_the_oldest_frames_are_lost(port, interpreter):
    air = WifiEnvironment(outages=((5, 9), (15, 40)), join_time=1.5)
    (sent,), truth, stats = run_node(72, port, air, interpreter=interpreter)
    t = check_and_get_times(sent, truth, stats)
    gaps = np.flatnonzero(np.diff(t) > 0.5)
    assert len(gaps) == 2, "one gap per outage"
    for (first_t, stop), gap in zip(air.outages, gaps, strict=True):
        assert t[gap] == pytest.approx(first_t, abs=0.2)
        # Pauses double: the last one is at most as long as the outage, and at most 30 s.
        assert stop - 2 * QUEUE_S - 1 < t[gap + 1] < stop + min(30, stop - first_t) + 4
    assert t[-1] > 71.5


@pytest.mark.parametrize("port", first_and_more("esp32", "rp2"))
def test_a_station_that_is_already_joining_at_power_on_connects(port):
    """After a soft reset an ESP32 continues its earlier connection attempt and refuses a new one."""
    (sent,), truth, stats = run_node(12, port, WifiEnvironment(join_time=2.5, joining_at_power_on=True))
    assert check_and_get_times(sent, truth, stats)[-1] > 11.5


@pytest.mark.parametrize(("port", "host"), each_value_first(PORTS, ["laptop.lan", "laptop.local"]))
def test_a_host_is_found_by_name_and_again_at_a_new_address_after_an_outage(port, host):
    """The name server is silent at first and again later: no loop waits for it."""
    air = WifiEnvironment(
        outages=((10, 12),),
        dns_outages=((0, 4), (11, 16)),
        dns_records=((0, host, "127.0.0.1"), (11, host, "127.0.0.2")),
    )
    (before, after), truth, stats = run_node(30, port, air, host=host, listeners=("127.0.0.1", "127.0.0.2"))
    t = check_and_get_times(before + after, truth, stats)
    first, second = (truth.t[match_samples(part, truth)[:, 0].astype(int)] for part in (before, after))
    assert 4 - QUEUE_S < first[0] < 6.5 and 9.5 < first[-1] < 10.1
    assert 16 - 2 < second[0] < 19 and second[-1] > 29.5
    assert (np.diff(t) > 0.5).sum() == 1


def test_a_host_with_a_new_address_is_found_within_half_a_minute():
    air = WifiEnvironment(dns_records=((0, "laptop.lan", "127.0.0.1"), (8, "laptop.lan", "127.0.0.2")))
    (before, after), truth, stats = run_node(
        45, "rp2", air, host="laptop.lan", listeners=("127.0.0.1", "127.0.0.2")
    )
    check_and_get_times(before + after, truth, stats)
    t = truth.t[match_samples(after, truth)[:, 0].astype(int)]
    assert 25 < t[0] < 8 + 30 and t[-1] > 44.5
