"""Link threads: after any exception or hang of a driver the link is reopened, and others lose nothing."""

import itertools
import queue
import socket
import threading
import time
from collections import Counter

import pytest

from fakes.fake_node import FakeNode
from fakes.recorder_thread import RecorderThread
from faults.line import T0, Node, StoredRecords
from hubodo.errors import LinkError
from hubodo.ingest.link import link as link_module
from hubodo.ingest.link.link import Chunk, LinkLost, LinkUp, PortLink
from hubodo.ingest.link.ports import DeviceFinder, parse_port
from hubodo.ingest.link.retry import Backoff, ValidityCheck
from hubodo.ingest.link.session import LinkSession
from hubodo.ingest.link.transport import TcpTransport, UdpTransport
from hubodo.ingest.live.recorder import Recorder
from hubodo.log.recording_reader import open_log
from hubodo.units import NS_PER_S
from waiting import until

NEVER = threading.Event()


class Script:
    """A transport that faults at one of its calls while `bad` is set, and counts chunks otherwise."""

    datagrams = False
    endpoint = "script"

    def __init__(self, call="", deed=None):
        self.refused = Counter()
        self.call, self.deed, self.numbers = call, deed, itertools.count()
        self.written = []
        self._do("open")

    def _do(self, call):
        if call == self.call:
            self.deed()

    def read(self, timeout):
        self._do("read")
        time.sleep(0.001)
        return b"%d " % next(self.numbers), ""

    def write(self, data, to):
        self._do("write")
        self.written.append(data)

    def close(self):
        self._do("close")


def fails():
    raise RuntimeError("the driver's own bug")


def hangs():
    NEVER.wait()


@pytest.fixture
def links(monkeypatch):
    """Create two links, good and bad; the opening of the bad one can be changed."""
    ways, news = {}, queue.SimpleQueue()
    monkeypatch.setattr(link_module, "open_transport", lambda port, finder, baud: ways[port.label]())
    transports = {
        name: PortLink(parse_port(f"{name}=socket://x:1"), name, news, time.monotonic_ns)
        for name in ("good", "bad")
    }
    ways["good"] = Script
    yield transports["good"], transports["bad"], ways, Reports(news)
    NEVER.set()
    for link in transports.values():
        link.stop(1.0)
    NEVER.clear()


class Reports:
    """The reports of links so far."""

    def __init__(self, news):
        self._news, self._items = news, []

    def of(self, link, kind):
        while not self._news.empty():
            self._items.append(self._news.get())
        return [item for item in self._items if item.link == link.label and isinstance(item, kind)]

    def numbers(self, link):
        return [int(n) for item in self.of(link, Chunk) for n in item.data.split()]


def goes_on(link, reports):
    """Check that further numbers arrive without a gap."""
    before = len(reports.numbers(link))
    until(lambda: len(reports.numbers(link)) > before + 20)
    assert reports.numbers(link) == list(range(len(reports.numbers(link))))


@pytest.mark.parametrize("call", ["open", "read", "write", "close"])
def test_an_unexpected_exception_ends_that_attempt_and_the_link_is_retried(links, call):
    good, bad, ways, reports = links
    ways["bad"] = lambda: Script(call, fails)
    good.start()
    bad.start()
    if call in ("write", "close"):
        until(lambda: reports.of(bad, LinkUp))
        bad.send(b"x")
        if call == "close":
            bad._writer.error = RuntimeError("ends the connection")
    until(lambda: any(item.unexpected for item in reports.of(bad, LinkLost)))
    assert "RuntimeError" in reports.of(bad, LinkLost)[0].text
    ways["bad"] = Script
    until(lambda: reports.of(bad, LinkUp) and reports.of(bad, Chunk) and bad.send(b"y"))
    goes_on(good, reports)


@pytest.mark.parametrize("call", ["open", "read", "write", "close"])
def test_a_hanging_transport_blocks_neither_sending_nor_closing_nor_other_links(links, call):
    good, bad, ways, reports = links
    ways["bad"] = lambda: Script(call, hangs)
    good.start()
    bad.start()
    goes_on(good, reports)
    begun = time.monotonic()
    for _ in range(20):
        bad.send(b"x")
    assert time.monotonic() - begun < 2, "one write is waited for, and for a quarter of a second"
    assert good.send(b"x")
    begun = time.monotonic()
    bad.request_stop()
    bad.stop(0.2)
    assert time.monotonic() - begun < 2
    goes_on(good, reports)


def test_an_unexpected_error_of_the_first_attempt_is_one_line(links):
    _, bad, ways, _ = links
    ways["bad"] = lambda: Script("open", fails)
    with pytest.raises(
        LinkError, match="bad=socket://x:1: cannot be opened: RuntimeError: the driver's own bug"
    ):
        bad.open_now()


def test_a_list_of_ports_that_cannot_be_read_is_a_reason_not_an_end(tmp_path):
    def lister():
        raise OSError("comports failed")

    there = tmp_path / "ttyACM0"
    there.touch()
    assert DeviceFinder(parse_port(str(there)), lister).find_device() == str(there)
    for name in ("E661", str(tmp_path / "none")):
        with pytest.raises(LinkError, match="cannot be listed: OSError: comports failed"):
            DeviceFinder(parse_port(name), lister).find_device()


@pytest.mark.parametrize("transport", [TcpTransport, UdpTransport])
def test_an_invalid_host_name_is_reported(transport):
    with pytest.raises(LinkError, match=r"//a\.\.b:5: \w.*; "):
        transport("a..b", 5)


def test_a_failed_datagram_does_not_close_the_port():
    udp = UdpTransport("127.0.0.1", 0)
    for address in ("255.255.255.255 9", "127.0.0.1 0", "240.0.0.1 9"):
        udp.write(b"x", address)
    assert udp.read(0.0) == (b"", "")
    udp.close()


def test_a_bridge_that_accepts_and_closes_is_tried_less_and_less_often():
    with socket.create_server(("127.0.0.1", 0)) as server:
        accepted = []

        def bridge():
            while True:
                try:
                    connection, _ = server.accept()
                except OSError:
                    return
                accepted.append(time.monotonic())
                connection.close()

        threading.Thread(target=bridge, daemon=True).start()
        port = parse_port(f"socket://127.0.0.1:{server.getsockname()[1]}")
        link = PortLink(port, "bridge", queue.SimpleQueue(), time.monotonic_ns)
        link.start()
        until(lambda: len(accepted) >= 5)
        link.stop()
        server.shutdown(socket.SHUT_RDWR)
    pauses = [after - before for before, after in itertools.pairwise(accepted)]
    assert all(pause >= wanted for pause, wanted in zip(pauses, (0.1, 0.2, 0.4), strict=False))


def test_pauses_double_to_eight_seconds_and_a_valid_frame_resets_them():
    backoff = Backoff()
    pauses = [backoff.pause_after_loss(was_valid=False) for _ in range(20)]
    assert pauses[:4] == [0.1, 0.2, 0.4, 0.8] and pauses[-1] == 8.0
    assert (
        sum(1 for _ in itertools.takewhile(lambda t: t < 86400, itertools.accumulate(pauses + [8.0] * 20000)))
        < 11000
    )
    assert backoff.pause_after_loss(was_valid=True) == 0.05
    assert (
        backoff.pause_after_failed_open() <= 0.2
        and max(backoff.pause_after_failed_open() for _ in range(50)) == 1.0
    )


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (Node().hello_frame(), True),
        (b"$GPGLL,5300.97914,N,00259.98174,E,125926,A*28\r\n", True),
        (b"$GPGLL,5300.97914,N,00259.98174,E,125926,A*29\r\n", False),
        (b"login: ", False),
        (bytes(range(1, 256)) * 40, False),
    ],
)
@pytest.mark.parametrize("size", [1, 7, 100_000])
def test_a_connection_has_carried_something_valid_after_a_frame_or_a_sentence(data, expected, size):
    check = ValidityCheck(T0)
    for at in range(0, len(data), size):
        check.feed(data[at : at + size])
    assert check.is_valid(T0 + NS_PER_S) == expected
    assert check.is_valid(T0 + 10 * NS_PER_S), "or for ten seconds"


def test_connections_without_a_frame_are_few_events_and_a_frame_makes_the_next_loss_one():
    sink = StoredRecords()
    session, now = LinkSession("bridge", sink), T0
    for _ in range(450):  # one hour of attempts eight seconds apart
        session.handle_up(LinkUp("bridge", now, "socket://x:1", False))
        session.handle_lost(LinkLost("bridge", now, "closed by the other side"))
        list(session.tick(now))
        now += 8 * NS_PER_S
    lost = [event for event in sink.events if event.kind == "disconnected"]
    assert len(sink.events) < 20
    assert sum(event.data["attempts"] for event in lost) > 200, "the others are counted"
    sink.events.clear()
    session.handle_up(LinkUp("bridge", now, "socket://x:1", False))
    assert not sink.events
    assert list(session.route_frames(Chunk("bridge", now, b"\0" + Node().hello_frame(), "")))
    assert [event.kind for event in sink.events] == ["connected"]
    assert sink.events[0] in session.connection.take_notices()
    session.handle_lost(LinkLost("bridge", now, "unplugged"))
    assert sink.events[-1].kind == "disconnected"


def test_a_receiver_that_is_unplugged_and_back_is_reported_and_in_the_log():
    sink = StoredRecords()
    recorder = Recorder({"usb0": None}, sink, lambda *_: True, lambda: T0, gnss=["gnss"])
    sentence = b"$GPGLL,5300.97914,N,00259.98174,E,125926,A*28\r\n"
    recorder.handle(LinkUp("gnss", T0, "/dev/g", False))
    for k in range(1, 4):
        recorder.handle(Chunk("gnss", T0 + k, sentence, ""))
        recorder.handle(LinkLost("gnss", T0 + k, "unplugged", unexpected=k == 2))
        recorder.handle(LinkUp("gnss", T0 + k, "/dev/g", False))
    assert sink.kinds() == ["connected"] + ["disconnected", "connected"] * 3
    assert [event.kind for event in recorder.notices] == ["disconnected", "connected"] * 3
    assert recorder.gnss["gnss"].connection.faults == 1


def test_a_driver_that_raises_is_counted_in_the_log_and_the_node_beside_it_loses_nothing(
    tmp_path, monkeypatch
):
    real = link_module.open_transport

    def opened(port, finder, baud):
        return Script("read", fails) if port.kind == "tcp" else real(port, finder, baud)

    monkeypatch.setattr(link_module, "open_transport", opened)
    with FakeNode() as node:
        log = tmp_path / "drive.mcap"
        with RecorderThread(log, node.path, "socket://bad:1") as recorder:
            until(lambda: node.samples_created > 300)
        result = recorder.result.as_json()
    assert result["nodes"]["left"]["samples"] > 200 and result["nodes"]["left"]["samples_lost"] == 0
    with open_log(log) as records:
        events = [r.data for r in records.messages() if r.topic == "/hubodo/events"]
    assert any(b"RuntimeError" in event for event in events)
