"""Vectorised counterpart of `hubowire.FrameDecoder` for the raw frames of a log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hubowire.framing import (
    CRC_INITIAL,
    CRC_POLYNOMIAL,
    CRC_SIZE,
    DELIMITER,
    HEADER_SIZE,
    MAX_FRAME,
    Frame,
    StreamAccounting,
    crc16,
)

ByteArray = npt.NDArray[np.uint8]
WordArray = npt.NDArray[np.uint16]
IndexArray = npt.NDArray[np.intp]

# Below this number of frames of one size, calls into numpy cost more than checking one by one.
_MIN_VECTORISED_FRAMES = 12
# Bounds the working memory so that it fits the cache; the result does not depend on it.
_MAX_PIECE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class FrameGroup:
    """Frames of one message type, node and payload length, in order of arrival.

    Attributes
    ----------
    seq
        (n,) uint16 sequence numbers.
    end_offset
        (n,) int64 position in the stream behind each frame's delimiter, bytes since the decoder was created:
        gives the order across groups and the time of arrival.
    payload
        (n, length) uint8.
    """

    type_id: int
    node: int
    seq: WordArray
    end_offset: npt.NDArray[np.int64]
    payload: ByteArray

    def select(self, rows: IndexArray) -> FrameGroup:
        """Return the frames at these rows."""
        return FrameGroup(self.type_id, self.node, self.seq[rows], self.end_offset[rows], self.payload[rows])

    def frame_at(self, row: int) -> Frame:
        """Return the frame at one row."""
        return Frame(self.type_id, self.node, int(self.seq[row]), self.payload[row].tobytes())


class BulkDecoder(StreamAccounting):
    """A decoder of bytes to groups of frames; frames and counters equal those of `FrameDecoder`.

    The raw frames of a log are fed with their zero delimiters.
    """

    def feed(self, data: bytes) -> list[FrameGroup]:
        """Return the valid frames that end within `data`; several groups may be of one kind."""
        view = memoryview(data)
        groups: list[FrameGroup] = []
        for start in range(0, len(view), _MAX_PIECE_BYTES):
            groups += self._feed_piece(view[start : start + _MAX_PIECE_BYTES])
        return groups

    def _feed_piece(self, piece: memoryview) -> list[FrameGroup]:
        origin = self.bytes_in - len(self._pending)
        self.bytes_in += len(piece)
        # A writable copy, because bytes are unstuffed in place.
        stream = np.frombuffer(bytearray().join((self._pending, piece)), dtype=np.uint8)
        ends = np.flatnonzero(stream == DELIMITER)
        starts = np.concatenate((np.zeros(1, dtype=np.intp), ends + 1))
        tail, starts = stream[starts[-1] :], starts[:-1]
        if self._skipping and len(ends):
            self._skipping = False
            self.damage.bytes_lost += int(ends[0]) + 1
            starts, ends = starts[1:], ends[1:]
        self._store_tail(tail)
        lengths = ends - starts
        fits = (lengths > 0) & (lengths < MAX_FRAME)
        if not fits.all():
            self.idle_delimiters += int(np.count_nonzero(lengths == 0))
            self._count_lost("oversize", lengths[lengths >= MAX_FRAME])
            starts, ends = starts[fits], ends[fits]
        return list(self._group_frames(stream, starts, ends, origin))

    def _store_tail(self, tail: ByteArray) -> None:
        self._pending = b""
        if self._skipping:
            self.damage.bytes_lost += len(tail)
        elif len(tail) < MAX_FRAME:
            self._pending = tail.tobytes()
        else:
            self._skipping = True
            self.damage.oversize += 1
            self.damage.bytes_lost += len(tail)

    def _group_frames(
        self, stream: ByteArray, starts: IndexArray, ends: IndexArray, origin: int
    ) -> Iterator[FrameGroup]:
        is_unstuffed = _unstuff_in_place(stream, starts, ends)
        lengths = ends - starts
        self._count_lost("cobs", lengths[~is_unstuffed])
        is_short = is_unstuffed & (lengths <= HEADER_SIZE + CRC_SIZE)
        self._count_lost("short", lengths[is_short])
        is_candidate = is_unstuffed & ~is_short
        if not is_candidate.all():
            starts, ends, lengths = starts[is_candidate], ends[is_candidate], lengths[is_candidate]
        # A body (header to CRC) is one COBS code byte shorter than the stuffed frame.
        sizes = (lengths - 1).astype(np.uint8)
        is_valid = _crc_matches(stream, starts, sizes)
        if not is_valid.all():
            self._count_lost("crc", lengths[~is_valid])
            starts, ends, sizes = starts[is_valid], ends[is_valid], sizes[is_valid]
        for size, rows in _group_by_value(sizes):
            bodies = _gather_rows(stream, starts[rows] + 1, size)
            self.bytes_framed += len(bodies) * (size + 2)
            header = bodies[:, :HEADER_SIZE].copy().view("<u2")
            end = ends[rows] + (origin + 1)
            for key, members in _group_by_value(header[:, 0]):
                payload = bodies[members, HEADER_SIZE:-CRC_SIZE]
                yield FrameGroup(key & 0xFF, key >> 8, header[members, 1], end[members], payload)

    def _count_lost(self, cause: Literal["crc", "cobs", "short", "oversize"], lengths: IndexArray) -> None:
        if len(lengths):
            setattr(self.damage, cause, getattr(self.damage, cause) + len(lengths))
            self.damage.bytes_lost += int(lengths.sum()) + len(lengths)


def _group_by_value(values: npt.NDArray[Any]) -> Iterator[tuple[int, IndexArray | slice]]:
    """Yield each distinct value with its indices in ascending order; slice(None) for a single value."""
    if not len(values):
        return
    if (values == values[0]).all():
        yield int(values[0]), slice(None)
        return
    order = np.argsort(values, kind="stable")
    ranked = values[order]
    cuts = np.flatnonzero(ranked[1:] != ranked[:-1]) + 1
    for rows in np.split(order, cuts):
        yield int(values[rows[0]]), rows


def _unstuff_in_place(stream: ByteArray, starts: IndexArray, ends: IndexArray) -> npt.NDArray[np.bool_]:
    """Undo COBS in each [start, end) and return False for frames whose codes point outside.

    A code byte stands where the body has a zero, so only zeros are written; the first code byte becomes zero
    too. Each walk along the codes stays inside its own frame, so a damaged frame affects no other.
    """
    is_valid = np.ones(len(ends), dtype=bool)
    position, end = starts, ends
    active_count = len(position)
    while active_count:
        # A finished walk stays on its delimiter, whose code is 0; drop finished walks from time to time.
        if active_count < 0.8 * len(position):
            is_active = (position < end).nonzero()[0]
            position, end = position.take(is_active), end.take(is_active)
        code = stream.take(position)
        stream[position] = DELIMITER
        position = position + code
        is_outside = position > end
        if is_outside.any():
            is_valid[np.searchsorted(ends, end[is_outside])] = False
            position = np.minimum(position, end)
        active_count = int(np.count_nonzero(position < end))
    return is_valid


def _gather_rows(stream: ByteArray, starts: IndexArray, size: int) -> ByteArray:
    """Return the `size` bytes from each start as an array (n, size), each row copied as one item."""
    windows: npt.NDArray[Any] = np.ndarray(
        (max(len(stream) - size + 1, 0),), dtype=f"V{size}", buffer=stream.data, strides=(1,)
    )
    return windows[starts].view(np.uint8).reshape(len(starts), size)


def _crc_matches(stream: ByteArray, starts: IndexArray, sizes: ByteArray) -> npt.NDArray[np.bool_]:
    """Return (n,) bool: True where the body of a frame ends in the CRC of the bytes before."""
    is_valid = np.empty(len(sizes), dtype=bool)
    for size, rows in _group_by_value(sizes):
        row_starts = starts[rows]
        if len(row_starts) >= _MIN_VECTORISED_FRAMES:
            is_valid[rows] = _crc_matches_equal(stream, row_starts, size)
            continue
        for row in np.arange(len(sizes))[rows]:
            body = stream[starts[row] + 1 : starts[row] + 1 + size].tobytes()
            is_valid[row] = crc16(body[:-CRC_SIZE]) == int.from_bytes(body[-CRC_SIZE:], "little")
    return is_valid


def _crc_matches_equal(stream: ByteArray, starts: IndexArray, size: int) -> npt.NDArray[np.bool_]:
    """Check the CRC of bodies of one size, all frames in parallel, two bytes per step.

    An odd body is started one byte early, at the code byte that unstuffing has set to zero, with the
    register value that this zero transforms into the initial value.
    """
    table, initial_even, initial_odd = _crc_tables()
    odd = size & 1
    words = _gather_rows(stream, starts + (1 - odd), size + odd).view("<u2").T.copy()
    register = np.full(len(starts), initial_odd if odd else initial_even, dtype=np.uint16)
    for word in words[:-1]:
        register = table.take(register ^ word)
    matches: npt.NDArray[np.bool_] = register.byteswap() == words[-1]
    return matches


@cache
def _crc_tables() -> tuple[WordArray, np.uint16, np.uint16]:
    """Return the table of the CRC register after two bytes, and its initial value for even and odd bodies.

    Registers are byte-swapped so that little-endian words of the stream can be combined directly.
    """
    all_registers = np.arange(1 << 16, dtype=np.uint16)

    def after_zero_byte(register: WordArray) -> WordArray:
        for _ in range(8):
            register = np.where(register >> 15, (register << 1) ^ CRC_POLYNOMIAL, register << 1)
        return register.astype(np.uint16)

    after_one_byte = after_zero_byte(all_registers)
    after_two_bytes = after_zero_byte(after_one_byte)
    before_initial = all_registers[after_one_byte == CRC_INITIAL]
    return (
        after_two_bytes[all_registers.byteswap()].byteswap(),
        np.uint16(CRC_INITIAL).byteswap(),
        before_initial.byteswap()[0],
    )
