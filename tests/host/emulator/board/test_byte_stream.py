"""A byte stream of the emulated processor: the time at which a UART has sent its bytes."""

import pytest

from hubodo.emulator.board.byte_stream import ByteStream
from hubodo.emulator.board.link import TX_FIFO

BYTE_NS = 10 / 115200 * 1e9
"""Start bit, eight bits and stop bit at 115200 baud."""


class Listener:
    """A link that accepts everything."""


def test_a_stream_without_timing_always_has_its_whole_buffer_free() -> None:
    stream = ByteStream(wire_free=1e12)
    assert stream.free_space(0.0) == TX_FIFO


def test_a_uart_sends_its_bytes_one_after_another() -> None:
    stream = ByteStream(byte_ns=BYTE_NS, send_buffer=4, link=Listener())  # type: ignore[arg-type]
    # Four bytes fit into the buffer, so the firmware continues at once.
    assert stream.put_on_wire(1000.0, b"abcd", 4) == 1000.0
    assert stream.wire_free == pytest.approx(1000.0 + 4 * BYTE_NS)
    # Two more bytes wait until two have been sent.
    assert stream.put_on_wire(1000.0, b"ef", 2) == pytest.approx(1000.0 + 2 * BYTE_NS)
    assert [sent for _, sent in stream.on_wire] == [b"abcd", b"ef"]
    assert [end for end, _ in stream.on_wire] == pytest.approx([1000.0 + 4 * BYTE_NS, 1000.0 + 6 * BYTE_NS])


def test_the_wire_idles_between_transmissions() -> None:
    stream = ByteStream(byte_ns=BYTE_NS, send_buffer=4)
    stream.put_on_wire(0.0, b"a", 1)
    stream.put_on_wire(10 * BYTE_NS, b"b", 1)
    assert stream.wire_free == pytest.approx(11 * BYTE_NS)
    # Without a listener the bytes take the same time and are discarded.
    assert not stream.on_wire


def test_free_space_grows_by_a_byte_per_byte_time() -> None:
    stream = ByteStream(byte_ns=BYTE_NS, send_buffer=8)
    stream.put_on_wire(0.0, bytes(8), 8)
    # A byte whose stop bit is not sent yet still occupies its place in the buffer.
    spaces = [stream.free_space(time * BYTE_NS) for time in (0.0, 0.5, 1.01, 7.5, 8.01, 99.0)]
    assert spaces == [0, 0, 1, 7, 8, 8]


def test_clearing_discards_all_bytes_and_frees_the_wire() -> None:
    stream = ByteStream(byte_ns=BYTE_NS, link=Listener())  # type: ignore[arg-type]
    stream.received += b"x"
    stream.to_send += b"y"
    stream.put_on_wire(0.0, b"z", 1)
    stream.clear()
    assert (stream.received, stream.to_send, list(stream.on_wire)) == (b"", b"", [])
    assert stream.free_space(0.0) == TX_FIFO
