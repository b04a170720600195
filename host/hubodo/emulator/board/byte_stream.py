"""A byte stream of the processor: standard input and output, or a UART with buffers and baud rate."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from hubodo.emulator.board.link import RX_FIFO, TX_FIFO, HostLink


@dataclass
class ByteStream:
    """A byte stream with its buffers.

    Attributes
    ----------
    received, to_send : bytes not yet read by the firmware, and not yet accepted by the link.
    link : link to the host, or None.
    byte_ns : ns per byte of a UART; 0 for a stream without timing.
    send_buffer, receive_buffer : capacities, bytes.
    on_wire : transmissions in progress as (time of their end in ns, bytes).
    wire_free : time of the end of the last transmission, ns.
    """

    received: bytearray = field(default_factory=bytearray)
    to_send: bytearray = field(default_factory=bytearray)
    link: HostLink | None = None
    byte_ns: float = 0.0
    send_buffer: int = TX_FIFO
    receive_buffer: int = RX_FIFO
    on_wire: deque[tuple[float, bytes]] = field(default_factory=deque)
    wire_free: float = 0.0

    def free_space(self, t: float) -> int:
        """Return the free bytes of the send buffer at t."""
        if not self.byte_ns:
            return self.send_buffer
        return self.send_buffer - math.ceil(max(0.0, self.wire_free - t) / self.byte_ns)

    def put_on_wire(self, t: float, sent: bytes, size: int) -> float:
        """Transmit at the rate of the UART; return the time at which the last byte is in the send buffer."""
        self.wire_free = max(self.wire_free, t) + self.byte_ns * size
        if self.link is not None:
            self.on_wire.append((self.wire_free, sent))
        return max(t, self.wire_free - self.byte_ns * self.send_buffer)

    def clear(self) -> None:
        """Clear the buffers."""
        for queue in (self.received, self.to_send, self.on_wire):
            queue.clear()
        self.wire_free = 0.0
