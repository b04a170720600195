"""Link budget: the load of a stream of samples on a link."""

from dataclasses import dataclass
from math import ceil

from hubowire.codec import payload_layout
from hubowire.framing import OVERHEAD
from hubowire.messages import Filter, Health, Hello, ImuBatch, Mag, Message, TimeReply

UART_BAUD = 921600
"""Default baud rate of the UART of a node: sufficient for every sample rate of the chips."""
CONSOLE_BAUD = 115200
"""Fixed baud rate of the console of an ESP32."""

MAX_LINK_LOAD = 0.8
"""Largest share of a link that is accepted; the rest is reserved for replies, jitter and retries."""
# Messages of a node other than samples, with default settings: message, rows of its table, frames per second.
_BACKGROUND_MESSAGES: tuple[tuple[type[Message], int, float], ...] = (
    (Filter, 0, 5),
    (Mag, 0, 10),
    (Health, 0, 1),
    (TimeReply, 0, 1),
    (Hello, 2, 0.2),
)


@dataclass(frozen=True, slots=True)
class LinkCapacity:
    """Capacity of a link, on which a packet takes packet_s + bytes / bytes_per_s.

    Attributes
    ----------
    name : name for tables and messages.
    bytes_per_s : B/s.
    packet_bytes : largest part of a frame in one packet, B; 0 for a plain byte stream.
    packet_s : s, overhead per packet.
    """

    name: str
    bytes_per_s: float
    packet_bytes: int = 0
    packet_s: float = 0.0

    def load(self, frame_bytes: int, frames_per_s: float) -> float:
        """Return the share of link time that frames take; above 1 they do not fit."""
        packets = ceil(frame_bytes / self.packet_bytes) if self.packet_bytes else 0
        return frames_per_s * (frame_bytes / self.bytes_per_s + packets * self.packet_s)


def serial_link(baud: int) -> LinkCapacity:
    """Return the capacity of a serial line with 8N1: ten bits per byte."""
    return LinkCapacity(f"UART {baud}", baud / 10)


def nrf24_link() -> LinkCapacity:
    """Return the capacity of an nRF24L01+ at 250 kb/s with acknowledgements and fragmented frames.

    Two of 32 payload bytes are the fragment header (frame number, index and count). A packet has 1 byte of
    preamble, 5 of address, 9 bits of control and 2 bytes of CRC; an acknowledgement the same without payload;
    each direction settles for 130 us (nRF24L01+ product specification 1.0, sections 6.1 and 7.3).
    """
    byte_s = 8 / 250e3
    overhead_s = (1 + 5 + 2) * byte_s + 9 / 250e3
    return LinkCapacity("nRF24 250 kb/s", 1 / byte_s, 30, 2 * byte_s + 2 * overhead_s + 2 * 130e-6)


# Full-speed bulk transfers: at most 19 packets of 64 bytes in each millisecond (USB 2.0, table 5-9).
LINKS = (
    serial_link(CONSOLE_BAUD),
    serial_link(UART_BAUD),
    LinkCapacity("USB CDC", 19 * 64 * 1000.0),
    LinkCapacity("radio 250 kb/s", 250e3 / 8),
    nrf24_link(),
)


def frame_bytes(message: type[Message], rows: int = 0) -> int:
    """Return the bytes on the wire of a message with `rows` rows in its table, delimiter included."""
    layout = payload_layout(message)
    return OVERHEAD + layout.fixed.size + (rows * layout.rows.size if layout.rows else 0)


def imu_frame_bytes(batch: int) -> int:
    """Return the bytes on the wire of an ImuBatch of `batch` samples, delimiter included."""
    return frame_bytes(ImuBatch, batch)


def background_frames() -> tuple[tuple[int, float], ...]:
    """Return (frame bytes, frames per second) of all messages of a node other than samples."""
    return tuple((frame_bytes(message, rows), rate) for message, rows, rate in _BACKGROUND_MESSAGES)


def link_load(link: LinkCapacity, rate_hz: float, batch: int) -> float:
    """Return the share of a link that one node takes, with all its messages."""
    frames = ((imu_frame_bytes(batch), rate_hz / batch), *background_frames())
    return sum(link.load(size, rate) for size, rate in frames)


def node_bytes_per_s(rate_hz: float, batch: int) -> float:
    """Return the bytes per second of one node, with all its messages."""
    frames = ((imu_frame_bytes(batch), rate_hz / batch), *background_frames())
    return sum(size * rate for size, rate in frames)
