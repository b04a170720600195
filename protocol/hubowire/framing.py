"""Frames on a byte stream: COBS and CRC-16 without I/O. Damaged frames are counted by cause."""

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

_FRAME_HEADER = struct.Struct(HEADER_FORMAT)
_FRAME_CRC = struct.Struct("<H")
_MIN_BODY = HEADER_SIZE + CRC_SIZE


def crc16(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE of data."""
    return crc_hqx(data, CRC_INITIAL)


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame: message type, node id, sequence number modulo 2^16, payload."""

    type_id: int
    node: int
    seq: int
    payload: bytes


@dataclass(slots=True)
class Damage:
    """Counts of damaged frames by cause, and their bytes.

    Attributes
    ----------
    crc : frames with a wrong CRC.
    cobs : frames in which a code points past the delimiter.
    short : frames shorter than header and CRC.
    oversize : frames without delimiter within MAX_FRAME bytes.
    cut : frames in which the stream ended.
    bytes_lost : bytes of all of these.
    """

    crc: int = 0
    cobs: int = 0
    short: int = 0
    oversize: int = 0
    cut: int = 0
    bytes_lost: int = 0

    @property
    def frames(self) -> int:
        """Number of damaged frames."""
        return self.crc + self.cobs + self.short + self.oversize + self.cut


def cobs_encode(body: bytes) -> bytes:
    """Return the COBS encoding (Cheshire and Baker 1999) of fewer than 254 bytes, one byte longer."""
    encoded = bytearray()
    for run in body.split(b"\0"):
        encoded.append(len(run) + 1)
        encoded += run
    return bytes(encoded)


def cobs_decode(encoded: bytes) -> bytes | None:
    """Return the decoded bytes of fewer than 255 bytes of COBS; None if they are invalid."""
    if DELIMITER in encoded:
        return None
    decoded = bytearray(encoded)
    position, end = 0, len(decoded)
    # A code byte replaces each zero of the body: decoding restores the zeros in place.
    while position < end:
        code = decoded[position]
        decoded[position] = 0
        position += code
    return bytes(decoded[1:]) if position == end else None


def encode_frame(frame: Frame) -> bytes:
    """Return the bytes of a frame with its closing delimiter.

    Raise ValueError if the payload is longer than MAX_PAYLOAD.
    """
    if len(frame.payload) > MAX_PAYLOAD:
        raise ValueError(f"payload of {len(frame.payload)} bytes: at most {MAX_PAYLOAD} fit a frame")
    body = _FRAME_HEADER.pack(frame.type_id, frame.node, frame.seq & 0xFFFF) + frame.payload
    return cobs_encode(body + _FRAME_CRC.pack(crc16(body))) + b"\0"


class StreamAccounting:
    """Byte counters of a stream of frames, and its incomplete frame.

    Every byte is accounted for: bytes_in = bytes_framed + damage.bytes_lost + idle_delimiters +
    pending_bytes. An idle delimiter follows another delimiter; a sender may insert them between frames.
    """

    def __init__(self) -> None:
        self.damage = Damage()
        self.bytes_in = 0
        self.bytes_framed = 0
        self.idle_delimiters = 0
        self._pending = b""
        self._skipping = False

    @property
    def pending_bytes(self) -> int:
        """Buffered bytes of an incomplete frame."""
        return len(self._pending)

    def interrupt(self) -> None:
        """Discard an incomplete frame where the stream breaks: the port closed, or the file ended.

        Otherwise its bytes would damage the first frame after reconnection.
        """
        self._skipping = False
        if self._pending:
            self.damage.cut += 1
            self.damage.bytes_lost += len(self._pending)
            self._pending = b""


class FrameDecoder(StreamAccounting):
    """Decoder of a byte stream in chunks of any size; it buffers at most one frame."""

    def feed(self, data: bytes) -> list[Frame]:
        """Return the valid frames that end in `data`."""
        frames = (self.decode_frame(encoded) for encoded in self.split_frames(data))
        return [frame for frame in frames if frame is not None]

    def split_frames(self, data: bytes) -> list[bytes]:
        """Return the COBS bytes between delimiters, as input of `decode_frame` and content of a raw log."""
        self.bytes_in += len(data)
        *complete, incomplete = bytes(data).split(b"\0")
        frames = []
        if complete:
            if self._skipping:
                self.damage.bytes_lost += len(complete.pop(0)) + 1
                self._skipping = False
            else:
                complete[0] = self._pending + complete[0]
            self._pending = b""
        for encoded in complete:
            if len(encoded) >= MAX_FRAME:
                self.damage.oversize += 1
                self.damage.bytes_lost += len(encoded) + 1
            elif encoded:
                frames.append(encoded)
            else:
                self.idle_delimiters += 1
        if self._skipping:
            self.damage.bytes_lost += len(incomplete)
        elif len(self._pending) + len(incomplete) >= MAX_FRAME:
            self.damage.oversize += 1
            self.damage.bytes_lost += len(self._pending) + len(incomplete)
            self._pending = b""
            self._skipping = True
        else:
            self._pending += incomplete
        return frames

    def decode_frame(self, encoded: bytes) -> Frame | None:
        """Return the frame of COBS bytes, or None after counting its damage."""
        body = cobs_decode(encoded)
        if body is None:
            self.damage.cobs += 1
        elif len(body) < _MIN_BODY:
            self.damage.short += 1
        elif crc16(body[:-CRC_SIZE]) != _FRAME_CRC.unpack_from(body, len(body) - CRC_SIZE)[0]:
            self.damage.crc += 1
        else:
            self.bytes_framed += len(encoded) + 1
            type_id, node, seq = _FRAME_HEADER.unpack_from(body)
            return Frame(type_id, node, seq, body[HEADER_SIZE:-CRC_SIZE])
        self.damage.bytes_lost += len(encoded) + 1
        return None
