"""The virtual computer: time advances while it is waited for, independent of the speed of the machine."""

import time

import numpy as np

from fakes.fake_node import FakeNode
from fakes.script import Script
from fakes.talker import Talker
from hubodo.ingest.link.link import Chunk, LinkLost, LinkUp
from hubodo.ingest.link.ports import list_devices, parse_port
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.log.recording_reader import read_recording
from hubodo.units import NS_PER_S


def opened(computer, path, label):
    link = computer.create_link(parse_port(str(path)), label, 115200, list_devices)
    link.open_now()
    link.start()
    assert isinstance(computer.next_report(0.0), LinkUp)
    return link


def test_virtual_time_advances_only_while_waiting():
    computer = VirtualComputer()
    start = computer.now_ns()
    time.sleep(0.01)
    assert computer.next_report(0.0) is None and computer.now_ns() == start
    assert computer.next_report(0.25) is None and computer.now_ns() == start + NS_PER_S // 4
    computer.put("news")
    assert computer.next_report(9.0) == "news" and computer.now_ns() == start + NS_PER_S // 4


def test_bytes_of_devices_arrive_in_order_at_their_sending_time():
    computer = VirtualComputer()
    start = computer.now_ns()
    with (
        Talker(computer, 0.003, lambda since: b"often") as often,
        Talker(computer, 0.007, lambda since: b"seldom") as seldom,
    ):
        links = [opened(computer, talker.path, name) for talker, name in ((seldom, "s"), (often, "o"))]
        came = []
        while computer.now_ns() < start + NS_PER_S // 20:
            came.append(computer.next_report(0.1))
        for link in links:
            link.stop()
    assert all(isinstance(chunk, Chunk) for chunk in came)
    reports = [(round((chunk.t_ns - start) / 1e6), chunk.link) for chunk in came]
    assert reports[:8] == [(3, "o"), (6, "o"), (7, "s"), (9, "o"), (12, "o"), (14, "s"), (15, "o"), (18, "o")]
    assert {chunk.data for chunk in came} == {b"often", b"seldom"}


def test_a_cable_that_is_pulled_and_reconnected_is_reported_at_its_times(tmp_path):
    computer, link = VirtualComputer(), tmp_path / "tty"
    start = computer.now_ns()
    Script(computer, (0.2, lambda: node.unplug()), (0.4, lambda: node.plug()))
    with FakeNode(link=link, computer=computer) as node:
        opened(computer, link, "left")
        reports = []
        while computer.now_ns() < start + NS_PER_S:
            item = computer.next_report(0.1)
            reports += (
                [(type(item), (item.t_ns - start) / NS_PER_S)] if isinstance(item, LinkUp | LinkLost) else []
            )
    (lost, pulled), (up, back) = reports
    assert (lost, up) == (LinkLost, LinkUp)
    assert 0.2 <= pulled < 0.22 and 0.4 <= back < 0.47


def recorded(out, passed):
    """Return times since the start and raw rates of a node recorded on a computer with this load."""
    computer = VirtualComputer(passed)
    start = computer.now_ns()
    with FakeNode(computer=computer) as node:
        record(RecordConfig(ports=(node.path,), duration=1.5), out, computer=computer)
    log = read_recording(out)
    left = log.nodes["left"]
    return left.t + (log.t_zero_ns - start) * 1e-9, left.gyro


def test_a_machine_that_stops_now_and_then_records_the_same(tmp_path):
    quick_t, quick = recorded(tmp_path / "quick.mcap", lambda t_ns: None)
    slow_t, slow = recorded(tmp_path / "slow.mcap", lambda t_ns: time.sleep(0.005))
    np.testing.assert_array_equal(slow, quick)
    np.testing.assert_allclose(slow_t, quick_t, atol=1e-6)
