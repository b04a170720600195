"""Frames on a byte stream: COBS and CRC-16, without I/O; damage is counted by cause, never raised."""

import struct
from binascii import crc_hqx
from dataclasses import dataclass

DELIMITER = 0
HEADER_FORMAT = "<BBH"
HEADER_SIZE = 4
CRC_POLYNOMIAL = 0x1021
CRC_INITIAL = 0xFFFF
CRC_SIZE = 2
MAX_FRAME = 250
OVERHEAD = 1 + HEADER_SIZE + CRC_SIZE + 1
MAX_PAYLOAD = MAX_FRAME - OVERHEAD

_HEADER = struct.Struct(HEADER_FORMAT)
_CRC = struct.Struct("<H")
_MIN_BODY = HEADER_SIZE + CRC_SIZE


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE."""
    return crc_hqx(data, CRC_INITIAL)


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame: message type, node id, sequence number modulo 2^16, payload."""

    type_id: int
    node: int
    seq: int
    payload: bytes


@dataclass(slots=True)
class Damage:
    """What a decoder had to give up, by cause, in frames; and all of it in bytes.

    crc: the check value differs. cobs: the chain of codes leads outside. short: less than a header and a
    CRC. oversize: no delimiter within MAX_FRAME bytes. cut: the stream ended within a frame.
    """

    crc: int = 0
    cobs: int = 0
    short: int = 0
    oversize: int = 0
    cut: int = 0
    bytes_lost: int = 0

    @property
    def frames(self) -> int:
        return self.crc + self.cobs + self.short + self.oversize + self.cut


def stuff(body: bytes) -> bytes:
    """COBS (Cheshire and Baker 1999) of fewer than 254 bytes: no zero inside, one byte longer."""
    out = bytearray()
    for run in body.split(b"\0"):
        out.append(len(run) + 1)
        out += run
    return bytes(out)


def unstuff(stuffed: bytes) -> bytes | None:
    """The body behind fewer than 255 bytes of COBS; None where they hold a zero or the codes lead outside."""
    if DELIMITER in stuffed:
        return None
    out = bytearray(stuffed)
    at, end = 0, len(out)
    # A code byte stands where the body has a zero, so writing the zeros in place is all there is to undo.
    while at < end:
        code = out[at]
        out[at] = 0
        at += code
    return bytes(out[1:]) if at == end else None


def encode_frame(frame: Frame) -> bytes:
    """The bytes of a frame with its closing delimiter.

    Raises ValueError when the payload is longer than MAX_PAYLOAD.
    """
    if len(frame.payload) > MAX_PAYLOAD:
        raise ValueError(f"payload of {len(frame.payload)} bytes: at most {MAX_PAYLOAD} fit a frame")
    body = _HEADER.pack(frame.type_id, frame.node, frame.seq & 0xFFFF) + frame.payload
    return stuff(body + _CRC.pack(crc16(body))) + b"\0"


class StreamAccount:
    """What becomes of the bytes of a stream that is cut into frames, and the frame that has not ended.

    Every byte is accounted for: bytes_in = bytes_framed + damage.bytes_lost + idle_delimiters + pending.
    An idle delimiter follows another: a sender may put one anywhere between frames.
    """

    def __init__(self) -> None:
        self.damage = Damage()
        self.bytes_in = 0
        self.bytes_framed = 0
        self.idle_delimiters = 0
        self._pending = b""
        self._skipping = False

    @property
    def pending(self) -> int:
        """Bytes kept of a frame that has not ended."""
        return len(self._pending)

    def cut(self) -> None:
        """The stream breaks here: the port closed, the file ended. The next byte begins a new frame.

        Without it the rest of a torn frame would spoil the first whole one after a replug.
        """
        self._skipping = False
        if self._pending:
            self.damage.cut += 1
            self.damage.bytes_lost += len(self._pending)
            self._pending = b""


class FrameDecoder(StreamAccount):
    """Bytes in any portions to frames. Holds at most one frame's bytes."""

    def feed(self, data: bytes) -> list[Frame]:
        """Every undamaged frame that ends within `data`."""
        frames = (self.decode(stuffed) for stuffed in self.split(data))
        return [frame for frame in frames if frame is not None]

    def split(self, data: bytes) -> list[bytes]:
        """The stuffed bytes between delimiters: what `decode` takes and a raw log keeps."""
        self.bytes_in += len(data)
        *whole, rest = bytes(data).split(b"\0")
        found = []
        if whole:
            if self._skipping:
                self.damage.bytes_lost += len(whole.pop(0)) + 1
                self._skipping = False
            else:
                whole[0] = self._pending + whole[0]
            self._pending = b""
        for stuffed in whole:
            if len(stuffed) >= MAX_FRAME:
                self.damage.oversize += 1
                self.damage.bytes_lost += len(stuffed) + 1
            elif stuffed:
                found.append(stuffed)
            else:
                self.idle_delimiters += 1
        if self._skipping:
            self.damage.bytes_lost += len(rest)
        elif len(self._pending) + len(rest) >= MAX_FRAME:
            self.damage.oversize += 1
            self.damage.bytes_lost += len(self._pending) + len(rest)
            self._pending = b""
            self._skipping = True
        else:
            self._pending += rest
        return found

    def decode(self, stuffed: bytes) -> Frame | None:
        """The frame behind stuffed bytes, or None after counting why there is none."""
        body = unstuff(stuffed)
        if body is None:
            self.damage.cobs += 1
        elif len(body) < _MIN_BODY:
            self.damage.short += 1
        elif crc16(body[:-CRC_SIZE]) != _CRC.unpack_from(body, len(body) - CRC_SIZE)[0]:
            self.damage.crc += 1
        else:
            self.bytes_framed += len(stuffed) + 1
            type_id, node, seq = _HEADER.unpack_from(body)
            return Frame(type_id, node, seq, body[HEADER_SIZE:-CRC_SIZE])
        self.damage.bytes_lost += len(stuffed) + 1
        return None
