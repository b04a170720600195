"""The link budget: what a stream of samples costs on a link, and whether the link carries it."""

from dataclasses import dataclass
from math import ceil

from hubowire.codec import layout
from hubowire.framing import OVERHEAD
from hubowire.messages import Filter, Health, Hello, ImuBatch, Mag, Message, TimeReply

UART_BAUD = 921600
"""What a node's UART speaks unless told otherwise, and its host: every rate of the chips fits."""
CONSOLE_BAUD = 115200
"""What the console of an ESP32 speaks, whatever the node is told."""

# A link is called full at this share: what is left takes answers, jitter and repeats.
FULL = 0.8
# What a node sends beside its samples with its default settings: message, rows of its table, frames a second.
_BACKGROUND: tuple[tuple[type[Message], int, float], ...] = (
    (Filter, 0, 5),
    (Mag, 0, 10),
    (Health, 0, 1),
    (TimeReply, 0, 1),
    (Hello, 2, 0.2),
)


@dataclass(frozen=True, slots=True)
class LinkCapacity:
    """A link by the time each packet takes: packet_s + bytes / bytes_per_s.

    packet_bytes: most bytes of a frame that one packet carries, 0 for a plain byte stream.
    """

    name: str
    bytes_per_s: float
    packet_bytes: int = 0
    packet_s: float = 0.0

    def load(self, frame_bytes: int, frames_per_s: float) -> float:
        """Share of the link's time that such frames take; above 1 they do not fit."""
        packets = ceil(frame_bytes / self.packet_bytes) if self.packet_bytes else 0
        return frames_per_s * (frame_bytes / self.bytes_per_s + packets * self.packet_s)


def serial_link(baud: int) -> LinkCapacity:
    """A serial line with 8N1: ten bits a byte."""
    return LinkCapacity(f"UART {baud}", baud / 10)


def nrf24_link() -> LinkCapacity:
    """nRF24L01+ at 250 kb/s with acknowledgements: what a fragmented frame costs.

    Of 32 payload bytes two go to a fragment header (frame number, place and count). A packet has 1 byte of
    preamble, 5 of address, 9 bits of control, 2 of CRC; the acknowledgement the same without payload; each
    direction settles for 130 us (nRF24L01+ product specification 1.0, sections 6.1 and 7.3).
    """
    byte_s = 8 / 250e3
    wrapping_s = (1 + 5 + 2) * byte_s + 9 / 250e3
    return LinkCapacity("nRF24 250 kb/s", 1 / byte_s, 30, 2 * byte_s + 2 * wrapping_s + 2 * 130e-6)


# Full-speed bulk transfers: at most 19 packets of 64 bytes in each millisecond (USB 2.0, table 5-9).
LINKS = (
    serial_link(CONSOLE_BAUD),
    serial_link(UART_BAUD),
    LinkCapacity("USB CDC", 19 * 64 * 1000.0),
    LinkCapacity("radio 250 kb/s", 250e3 / 8),
    nrf24_link(),
)


def frame_bytes(message: type[Message], rows: int = 0) -> int:
    """Bytes on the wire of a message with `rows` rows in its table, delimiter included."""
    shape = layout(message)
    return OVERHEAD + shape.fixed.size + (rows * shape.rows.size if shape.rows else 0)


def imu_frame_bytes(batch: int) -> int:
    """Bytes on the wire of an ImuBatch of `batch` samples, delimiter included."""
    return frame_bytes(ImuBatch, batch)


def background() -> tuple[tuple[int, float], ...]:
    """(frame bytes, frames per second) of what a node sends beside its samples."""
    return tuple((frame_bytes(message, rows), rate) for message, rows, rate in _BACKGROUND)


def load(link: LinkCapacity, rate_hz: float, batch: int) -> float:
    """Share of a link that one node takes, background included."""
    frames = ((imu_frame_bytes(batch), rate_hz / batch), *background())
    return sum(link.load(size, rate) for size, rate in frames)


def bytes_per_s(rate_hz: float, batch: int) -> float:
    """Bytes per second of one node, background included."""
    frames = ((imu_frame_bytes(batch), rate_hz / batch), *background())
    return sum(size * rate for size, rate in frames)
