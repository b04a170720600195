"""Many frames at once: the vectorised twin of `hubowire.FrameDecoder`, for what a log holds."""

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
    StreamAccount,
    crc16,
)

Bytes = npt.NDArray[np.uint8]
Words = npt.NDArray[np.uint16]
Indices = npt.NDArray[np.intp]

# Below this many frames of one size, calls into numpy cost more than checking one by one.
_FEW = 12
# Bounds the working memory and keeps it in the cache; the frames do not depend on it.
_PIECE = 1 << 20


@dataclass(frozen=True, slots=True)
class FrameGroup:
    """Frames of one message type, node and payload length, in the order they came.

    seq: (n,) uint16. payload: (n, length) uint8.
    end: (n,) int64, where each frame's delimiter ended, in bytes since the decoder was made: the order
        across groups, and the way to the time at which a frame was received.
    """

    type_id: int
    node: int
    seq: Words
    end: npt.NDArray[np.int64]
    payload: Bytes

    def take(self, rows: Indices) -> FrameGroup:
        """Those of its frames."""
        return FrameGroup(self.type_id, self.node, self.seq[rows], self.end[rows], self.payload[rows])

    def frame(self, row: int) -> Frame:
        """One of its frames."""
        return Frame(self.type_id, self.node, int(self.seq[row]), self.payload[row].tobytes())


class BulkDecoder(StreamAccount):
    """Bytes in any portions to groups of frames; frames and counters equal those of `FrameDecoder`.

    The raw frames of a log, kept without delimiters, are fed joined by zeros.
    """

    def feed(self, data: bytes) -> list[FrameGroup]:
        """The undamaged frames that end within `data`; several groups may be of one kind."""
        view = memoryview(data)
        groups: list[FrameGroup] = []
        for at in range(0, len(view), _PIECE):
            groups += self._feed_piece(view[at : at + _PIECE])
        return groups

    def _feed_piece(self, piece: memoryview) -> list[FrameGroup]:
        origin = self.bytes_in - len(self._pending)
        self.bytes_in += len(piece)
        # A copy that may be written: unstuffing works in place.
        stream = np.frombuffer(bytearray().join((self._pending, piece)), dtype=np.uint8)
        ends = np.flatnonzero(stream == DELIMITER)
        starts = np.concatenate((np.zeros(1, dtype=np.intp), ends + 1))
        tail, starts = stream[starts[-1] :], starts[:-1]
        if self._skipping and len(ends):
            self._skipping = False
            self.damage.bytes_lost += int(ends[0]) + 1
            starts, ends = starts[1:], ends[1:]
        self._keep(tail)
        lengths = ends - starts
        fits = (lengths > 0) & (lengths < MAX_FRAME)
        if not fits.all():
            self.idle_delimiters += int(np.count_nonzero(lengths == 0))
            self._lose("oversize", lengths[lengths >= MAX_FRAME])
            starts, ends = starts[fits], ends[fits]
        return list(self._groups(stream, starts, ends, origin))

    def _keep(self, tail: Bytes) -> None:
        self._pending = b""
        if self._skipping:
            self.damage.bytes_lost += len(tail)
        elif len(tail) < MAX_FRAME:
            self._pending = tail.tobytes()
        else:
            self._skipping = True
            self.damage.oversize += 1
            self.damage.bytes_lost += len(tail)

    def _groups(self, stream: Bytes, starts: Indices, ends: Indices, origin: int) -> Iterator[FrameGroup]:
        whole = _unstuff_in_place(stream, starts, ends)
        lengths = ends - starts
        self._lose("cobs", lengths[~whole])
        short = whole & (lengths <= HEADER_SIZE + CRC_SIZE)
        self._lose("short", lengths[short])
        left = whole & ~short
        if not left.all():
            starts, ends, lengths = starts[left], ends[left], lengths[left]
        # A body, header to CRC, is one code byte shorter than what was stuffed.
        sizes = (lengths - 1).astype(np.uint8)
        sound = _crc_matches(stream, starts, sizes)
        if not sound.all():
            self._lose("crc", lengths[~sound])
            starts, ends, sizes = starts[sound], ends[sound], sizes[sound]
        for size, rows in _by_value(sizes):
            bodies = _rows(stream, starts[rows] + 1, size)
            self.bytes_framed += len(bodies) * (size + 2)
            header = bodies[:, :HEADER_SIZE].copy().view("<u2")
            end = ends[rows] + (origin + 1)
            for key, members in _by_value(header[:, 0]):
                payload = bodies[members, HEADER_SIZE:-CRC_SIZE]
                yield FrameGroup(key & 0xFF, key >> 8, header[members, 1], end[members], payload)

    def _lose(self, cause: Literal["crc", "cobs", "short", "oversize"], lengths: Indices) -> None:
        if len(lengths):
            setattr(self.damage, cause, getattr(self.damage, cause) + len(lengths))
            self.damage.bytes_lost += int(lengths.sum()) + len(lengths)


def _by_value(values: npt.NDArray[Any]) -> Iterator[tuple[int, Indices | slice]]:
    """Each value that occurs, with the ascending indices of where; a slice of all where there is but one."""
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


def _unstuff_in_place(stream: Bytes, starts: Indices, ends: Indices) -> npt.NDArray[np.bool_]:
    """Undoes COBS for the bytes of each [start, end) together, code by code; False where codes lead outside.

    A code byte stands where the body has a zero, so zeros are all that has to be written; the first code
    byte becomes one too. Every walk stays inside its own frame, so a damaged frame harms no other.
    """
    whole = np.ones(len(ends), dtype=bool)
    at, end = starts, ends
    left = len(at)
    while left:
        # A walk that has ended stands on its delimiter, whose code 0 leaves it there; drop such now and then.
        if left < 0.8 * len(at):
            inside = (at < end).nonzero()[0]
            at, end = at.take(inside), end.take(inside)
        code = stream.take(at)
        stream[at] = DELIMITER
        at = at + code
        beyond = at > end
        if beyond.any():
            whole[np.searchsorted(ends, end[beyond])] = False
            at = np.minimum(at, end)
        left = int(np.count_nonzero(at < end))
    return whole


def _rows(stream: Bytes, starts: Indices, size: int) -> Bytes:
    """(n, size): the `size` bytes from each start on, each row copied as one item."""
    windows: npt.NDArray[Any] = np.ndarray(
        (max(len(stream) - size + 1, 0),), dtype=f"V{size}", buffer=stream.data, strides=(1,)
    )
    return windows[starts].view(np.uint8).reshape(len(starts), size)


def _crc_matches(stream: Bytes, starts: Indices, sizes: Bytes) -> npt.NDArray[np.bool_]:
    """Whether the body of each frame ends in the CRC of what is before."""
    sound = np.empty(len(sizes), dtype=bool)
    for size, rows in _by_value(sizes):
        at = starts[rows]
        if len(at) >= _FEW:
            sound[rows] = _crc_matches_equal(stream, at, size)
            continue
        for row in np.arange(len(sizes))[rows]:
            body = stream[starts[row] + 1 : starts[row] + 1 + size].tobytes()
            sound[row] = crc16(body[:-CRC_SIZE]) == int.from_bytes(body[-CRC_SIZE:], "little")
    return sound


def _crc_matches_equal(stream: Bytes, starts: Indices, size: int) -> npt.NDArray[np.bool_]:
    """`_crc_matches` for bodies of one size: two bytes a step, all frames abreast.

    An odd body is begun one byte early, at the code byte that unstuffing has made zero, with the register
    value that such a zero turns into the initial one.
    """
    table, begin_even, begin_odd = _crc_tables()
    odd = size & 1
    words = _rows(stream, starts + (1 - odd), size + odd).view("<u2").T.copy()
    register = np.full(len(starts), begin_odd if odd else begin_even, dtype=np.uint16)
    for word in words[:-1]:
        register = table.take(register ^ word)
    matches: npt.NDArray[np.bool_] = register.byteswap() == words[-1]
    return matches


@cache
def _crc_tables() -> tuple[Words, np.uint16, np.uint16]:
    """The CRC register after two more bytes, and its first value for even and odd bodies.

    Registers are kept with their bytes swapped, so that a little-endian word of the stream fits as it is.
    """
    every = np.arange(1 << 16, dtype=np.uint16)

    def after_zero_byte(register: Words) -> Words:
        for _ in range(8):
            register = np.where(register >> 15, (register << 1) ^ CRC_POLYNOMIAL, register << 1)
        return register.astype(np.uint16)

    one = after_zero_byte(every)
    two = after_zero_byte(one)
    before_initial = every[one == CRC_INITIAL]
    return two[every.byteswap()].byteswap(), np.uint16(CRC_INITIAL).byteswap(), before_initial.byteswap()[0]
