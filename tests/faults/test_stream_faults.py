"""Faults of a serial line, injected into its bytes, cost only the damaged data and are counted."""

import errno
import os
import random
import tracemalloc
from dataclasses import replace

import pytest

from faults.line import BATCH, HELLO, Line, Node
from hubodo.ingest.link.link import Chunk
from hubodo.ingest.link.open_link import LinkDown
from hubodo.ingest.link.ports import DeviceFinder, parse_port
from hubodo.ingest.link.serial_port import SerialTransport
from hubodo.ingest.link.transport import open_transport
from hubodo.ingest.node.gaps import LINK_DOWN
from hubodo.units import NS_PER_S


def test_a_disconnection_at_any_byte_of_a_frame_loses_that_frame_with_its_cause():
    whole = Node()
    whole.hello_frame()
    length = len(whole.batch())
    for at in range(length + 1):
        node, line = Node(), Line()
        line.receive(node.hello_frame())
        for _ in range(3):
            line.receive(node.batch())
        torn = node.batch()
        line.receive(torn[:at])
        line.unplug()
        line.wait(0.3)
        line.plug()
        line.receive(torn[at:])  # the remainder of the interrupted frame comes first
        for _ in range(3):
            line.receive(node.batch())
        sink = line.close()
        lost = 0 if at in (0, length) else BATCH
        halves = 2 if at < length - 1 else 1  # the final delimiter alone is not a frame
        assert line.link().frames_cut == (halves if lost else 0), f"byte {at}"
        assert sum(line.link().damage.values()) == 0, f"byte {at}"
        expected = [k for k in range(7 * BATCH) if not (lost and 3 * BATCH <= k < 4 * BATCH)]
        assert sink.numbers() == expected, f"byte {at}"
        assert sink.causes() == [LINK_DOWN] * bool(lost), f"byte {at}"
        assert line.link().connection.disconnections == 1


def test_a_node_that_is_reset_within_a_frame_loses_that_frame_only():
    node, line = Node(), Line()
    line.receive(node.hello_frame())
    line.receive(node.batch())
    line.receive(node.batch()[:20])
    node.restart(78)
    line.receive(b"\0" + node.hello_frame())  # the firmware starts with a delimiter
    line.receive(node.batch())
    sink = line.close()
    assert sum(line.link().damage.values()) == 1
    assert sink.numbers() == [*range(BATCH), *range(BATCH)]
    assert sink.kinds().count("reset") == 1


def test_two_nodes_with_one_id_on_one_line_are_reported_and_not_mixed():
    one, other = Node(), Node(replace(HELLO, serial=b"serial02", boot_id=12), clock_us=5_000_000)
    line = Line()
    line.receive(one.hello_frame())
    for _ in range(4):
        line.receive(one.batch())
    line.receive(other.hello_frame())
    for k in range(60):
        line.receive((one, other)[k % 2].batch())
        if k % 20 == 0:
            line.receive(one.hello_frame() + other.hello_frame())
    node = next(iter(line.recorder.nodes))
    assert node.decoder.counts.frames_undecoded == 60
    assert sum("serial" in notice.text for notice in line.recorder.notices) == 1
    for _ in range(5):
        line.receive(one.hello_frame(), seconds=5.0)  # the other was removed
    line.receive(one.batch())
    line.receive(one.hello_frame())
    sink = line.close()
    assert sink.kinds().count("conflict") == 1
    assert sink.numbers() == [*range(4 * BATCH), *range(one.index - BATCH, one.index)]
    frames = [raw for label, raw in sink.raws if label == "usb0"]
    assert len(frames) == line.link().frames, "each frame is in the raw log"


def test_a_board_that_was_exchanged_while_unplugged_is_no_conflict():
    one, other, line = Node(), Node(replace(HELLO, serial=b"serial02", boot_id=12)), Line()
    line.receive(one.hello_frame())
    line.receive(one.batch())
    line.unplug()
    line.plug()
    line.receive(other.hello_frame())
    line.receive(other.batch())
    sink = line.close()
    assert "conflict" not in sink.kinds()
    assert sink.numbers() == [*range(BATCH), *range(BATCH)]


def test_silence_after_frames_is_not_foreign_data_but_another_baud_rate_is():
    node, line = Node(), Line()
    line.receive(node.hello_frame())
    for _ in range(10):
        line.receive(node.batch() + b"\x05\x01")  # the start of the next frame
    line.wait(4.0)
    assert line.link().foreign is None and line.recorder.fatal_error() is None
    assert line.recorder.notices == []
    line.wait(2.0)
    assert ["no data for 5 s" in notice.text for notice in line.recorder.notices] == [True]
    rng = random.Random(3)
    for _ in range(40):
        line.receive(bytes(rng.choice((0x80, 0xF8, 0x00, 0xE6, 0x98)) for _ in range(80)), seconds=0.1)
    assert "baud rate" in line.link().foreign
    assert line.close().kinds().count("foreign") == 1


def test_a_node_that_crashes_into_its_prompt_is_reported_although_it_is_silent():
    node, line = Node(), Line()
    line.receive(node.hello_frame() + node.batch())
    line.receive(b'Traceback (most recent call last):\r\n  File "main.py", line 3\r\nMemoryError\r\n>>> ')
    line.wait(4.0)
    assert "MicroPython prompt" in line.link().foreign


def test_a_port_with_random_data_at_3_mb_per_s_loses_no_sample_of_the_others():
    """Five seconds of noise: memory and log are bounded, unlogged bytes counted, no sample lost."""
    rng = random.Random(4)
    noise = [rng.randbytes(30_000) for _ in range(20)]
    line, node = Line("usb0", "usb1"), Node()
    line.receive(node.hello_frame(), "usb0")
    tracemalloc.start()
    for k in range(500):
        line.recorder.handle(Chunk("usb1", line.now, noise[k % 20], ""))
        if k % 4 == 0:
            line.receive(node.batch(), "usb0", 0.0)
        line.now += NS_PER_S // 100
        line.recorder.tick(line.now)
        if k == 20:
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
    grown = tracemalloc.get_traced_memory()[1] - before
    tracemalloc.stop()
    babble = line.link("usb1")
    logged = sum(len(raw) for label, raw in line.sink.raws if label == "usb1/damaged")
    assert babble.bytes == 15_000_000
    assert 500_000 < logged < 6 * 200_000 and babble.unlogged_bytes > 500_000
    assert grown < 6_000_000
    assert "no frame" in babble.foreign
    sink = line.close()
    assert any("were not logged" in event.text for event in sink.events if event.kind == "damage")
    assert sink.numbers() == [k % 1000 for k in range(125 * BATCH)]


def test_with_a_node_clock_stepped_back_samples_wait_for_hello_without_loss():
    node, line = Node(clock_us=60_000_000), Line()
    line.receive(node.hello_frame())
    for _ in range(5):
        line.receive(node.batch())
    node.clock_us -= 30_000_000
    for _ in range(5):
        line.receive(node.batch())
    line.receive(node.hello_frame())
    for _ in range(5):
        line.receive(node.batch())
    line.receive(node.hello_frame())
    sink = line.close()
    assert sink.numbers() == list(range(15 * BATCH))
    assert "gap" not in sink.kinds() and "reset" not in sink.kinds()


@pytest.mark.parametrize("start", [65_530, 2**16 - BATCH])
def test_a_wrap_of_numbers_or_microseconds_is_no_loss(start):
    node = Node(index=start, clock_us=(1 << 30) - 100_000)
    node.seqs = {2: 65_533, 1: 65_535}
    line = Line()
    line.receive(node.hello_frame())
    for _ in range(20):
        line.receive(node.batch())
    sink = line.close()
    assert sink.numbers() == [k % 1000 for k in range(start, start + 20 * BATCH)]
    assert "gap" not in sink.kinds()


@pytest.fixture
def port():
    master, slave = os.openpty()
    transport = open_transport(
        parse_port(os.ttyname(slave)), DeviceFinder(parse_port(os.ttyname(slave))), 115200
    )
    os.close(slave)
    yield master, transport
    transport.close()


def test_a_disconnected_device_ends_the_link(port):
    master, transport = port
    os.write(master, b"abc")
    assert transport.read(1.0) == (b"abc", "")
    os.close(master)
    with pytest.raises(LinkDown):
        transport.read(1.0)


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (OSError(errno.EIO, "Input/output error"), "Input/output error"),
        (OSError(errno.ENODEV, "No such device"), "No such device"),
        (b"", "read by another program"),
    ],
)
def test_a_port_that_fails_or_is_ready_without_data_is_down_with_a_reason(port, answer, says, monkeypatch):
    master, transport = port
    os.write(master, b"abc")

    def read(fd, count):
        if isinstance(answer, bytes):
            return answer
        raise answer

    with monkeypatch.context() as patch:
        patch.setattr("hubodo.ingest.link.serial_port.os.read", read)
        with pytest.raises(LinkDown, match=says):
            transport.read(1.0)
    os.close(master)


def test_a_second_hubodo_reader_of_a_port_is_refused(port):
    master, transport = port
    with pytest.raises(Exception, match="busy"):
        SerialTransport(transport.endpoint, 115200)
    os.close(master)


def test_a_line_with_many_serial_numbers_is_one_conflict_with_bounded_memory():
    line, node = Line(), Node()
    line.receive(node.hello_frame())
    for number in range(2000):
        node.hello = replace(node.hello, serial=b"%08d" % number)
        line.receive(node.hello_frame(), seconds=0.001)
    (decoder,) = (node.decoder for node in line.recorder.nodes)
    assert len(decoder._serials_received) <= 8
    events = [event for event in line.close().events if event.kind == "conflict"]
    assert len(events) == 1
