"""Frames out of a log: the recorded ones, or, for logs without any, frames made from the samples."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from hubodo.earth import STANDARD_GRAVITY
from hubodo.errors import InputError
from hubodo.ingest.node.wire_batch import RAD_PER_NANO_DEG
from hubodo.log.hubodo_messages import decode_bytes_message
from hubodo.log.logfile import Log
from hubodo.log.topics import RAW_PREFIX
from hubodo.recording import Recording, Table
from hubowire import FINGERPRINT, Frame, encode, encode_frame
from hubowire.framing import FrameDecoder
from hubowire.messages import NODE_IDS, Ack, Hello, ImuBatch, Nack, TimeReply

_STEPS = 32767
_TEMPERATURE_LSB_UDEGC, _TEMPERATURE_OFFSET_UDEGC = 3_906, 25_000_000
_MAX_BATCH = 16
_TIME_TOLERANCE = 20e-6  # s: what a batch's even spacing may be off by; beyond, a new batch begins
_ANSWERS = (Ack.type_id, Nack.type_id, TimeReply.type_id)


@dataclass(frozen=True, slots=True)
class TimedFrame:
    """Bytes as they go over the line, delimiter included, and when: s on the log's time scale.

    frame: what is in them, None for damaged ones.
    """

    t: float
    data: bytes
    frame: Frame | None


@dataclass(frozen=True, slots=True)
class Quantisation:
    """What making frames from samples costs, for one node.

    gyro_step: rad/s, accel_step: m/s2: values move by at most half a step. time_error: s, the largest.
    temperature: whether there was one; if not, 25 degC is sent, because a frame always carries one.
    """

    node: str
    node_id: int
    gyro_step: float
    accel_step: float
    time_error: float
    temperature: bool


def raw_links(log: Log) -> list[str]:
    """The links whose frames are in a log."""
    log_topics = {stream.topic for stream in log.streams.values()}
    return sorted(
        {
            topic.removeprefix(RAW_PREFIX).partition("/")[0]
            for topic in log_topics
            if topic.startswith(RAW_PREFIX)
        }
    )


def recorded_frames(
    log: Log, links: Iterable[str], t_zero_ns: int, start: float | None, end: float | None
) -> Iterator[TimedFrame]:
    """The frames of links as they came, damaged ones too, by time of arrival.

    Answers to questions of the host of that time are left out: today's host asks its own. Raises
    InputError when two links carry one node id, as they cannot share a line.
    """
    owners: dict[int, str] = {}
    wanted = [RAW_PREFIX + link + tail for link in links for tail in ("", "/damaged")]
    bounds = [None if t is None else t_zero_ns + round(t * 1e9) for t in (start, end)]
    splitter, streams = FrameDecoder(), log.streams
    for message in log.messages(wanted, *bounds):
        data = decode_bytes_message(streams[message.channel].encoding, message.data)
        stuffed = data.rstrip(b"\0")
        frame = splitter.decode(stuffed) if stuffed else None
        if frame is not None and frame.type_id in _ANSWERS:
            continue
        if frame is not None:
            link = message.topic.removeprefix(RAW_PREFIX)
            owner = owners.setdefault(frame.node, link)
            if owner != link:
                raise InputError(
                    f"links {owner} and {link} both carry node id {frame.node}; choose one with --only"
                )
        yield TimedFrame((message.log_time - t_zero_ns) * 1e-9, data, frame)


def made_frames(
    recording: Recording, start: float | None, end: float | None
) -> tuple[Iterator[TimedFrame], list[Quantisation]]:
    """Frames that a node with steps as fine as 16 bits allow would have sent for the samples of a recording.

    Raises InputError when there is no node in it.
    """
    if not recording.nodes:
        raise InputError("the log holds neither frames nor nodes; there is nothing to play to a port")
    ids = _ids(recording.nodes)
    made = [_Maker(name, ids[name], table, start, end) for name, table in recording.nodes.items()]
    frames = heapq.merge(*(maker.frames() for maker in made), key=attrgetter("t"))
    return frames, [maker.quantisation for maker in made]


def _ids(names: Iterable[str]) -> dict[str, int]:
    """left 1, right 2, frame 3, as everywhere; the others from 4 on, in order."""
    others = (number for number in itertools.count(1) if number not in NODE_IDS.values())
    return {name: NODE_IDS[name] if name in NODE_IDS else next(others) for name in names}


class _Maker:
    """The frames of one node."""

    def __init__(self, name: str, node_id: int, table: Table, start: float | None, end: float | None) -> None:
        inside = np.ones(len(table), bool)
        if start is not None:
            inside &= table.t >= start
        if end is not None:
            inside &= table.t < end
        self._id = node_id
        self._t = table.t[inside]
        gyro, accel = table.gyro[inside], table.accel[inside]
        gyro_ndps = max(1, math.ceil(_peak(gyro) / RAD_PER_NANO_DEG / _STEPS))
        accel_ng = max(1, math.ceil(_peak(accel) / (1e-9 * STANDARD_GRAVITY) / _STEPS))
        gyro_step, accel_step = gyro_ndps * RAD_PER_NANO_DEG, accel_ng * 1e-9 * STANDARD_GRAVITY
        self._raw = np.rint(np.hstack([gyro / gyro_step, accel / accel_step])).astype(np.int16)
        self._temperature = _temperature(table, inside)
        self._ends = _batches(self._t)
        self._hello = Hello(
            FINGERPRINT,
            (0, 0, 0),
            name.encode("ascii", "replace")[:8].ljust(8, b"\0"),
            1,
            0,
            0,
            round(1e3 * _rate(self._t)),
            min(65535, math.ceil(gyro_ndps * 1e-9 * _STEPS)),
            min(255, math.ceil(accel_ng * 1e-9 * _STEPS)),
            gyro_ndps,
            accel_ng,
            _TEMPERATURE_LSB_UDEGC,
            _TEMPERATURE_OFFSET_UDEGC,
            0,
            _MAX_BATCH,
            0,
            min(65534, math.ceil(1e6 * self._time_error())),
        )
        self.quantisation = Quantisation(
            name, node_id, gyro_step, accel_step, self._time_error(), "temperature" in table
        )

    def frames(self) -> Iterator[TimedFrame]:
        """Hello, then the batches, each when its last sample is there."""
        if not len(self._t):
            return
        yield self._timed(float(self._t[0]), self._hello, 0)
        first = 0
        for seq, end in enumerate(self._ends):
            rows = tuple(map(tuple, self._raw[first:end].tolist()))
            t_us, period_ns = self._timing(first, end)
            batch = ImuBatch(
                t_us % (1 << 30), period_ns, first & 0xFFFF, int(self._temperature[first]), 0, rows
            )
            yield self._timed(float(self._t[end - 1]), batch, seq)
            first = end

    def _timing(self, first: int, end: int) -> tuple[int, int]:
        t_us = round((self._t[first] - self._t[0]) * 1e6)
        if end - first > 1:
            return t_us, round((self._t[end - 1] - self._t[first]) / (end - first - 1) * 1e9)
        return t_us, round(1e9 / _rate(self._t))

    def _timed(self, t: float, message: Hello | ImuBatch, seq: int) -> TimedFrame:
        frame = Frame(message.type_id, self._id, seq & 0xFFFF, encode(message))
        return TimedFrame(t, encode_frame(frame), frame)

    def _time_error(self) -> float:
        worst, first = 0.0, 0
        for end in self._ends:
            t_us, period_ns = self._timing(first, end)
            told = self._t[0] + t_us * 1e-6 + period_ns * 1e-9 * np.arange(end - first)
            worst = max(worst, float(np.abs(told - self._t[first:end]).max()))
            first = end
        return worst


def _batches(t: NDArray[np.float64]) -> list[int]:
    """Where batches end so that the times within each are even to the tolerance."""
    ends, first = [], 0
    while first < len(t):
        size = min(_MAX_BATCH, len(t) - first)
        while size > 2:
            part = t[first : first + size]
            even = np.linspace(part[0], part[-1], size)
            if float(np.abs(part - even).max()) <= _TIME_TOLERANCE:
                break
            size //= 2
        first += size
        ends.append(first)
    return ends


def _rate(t: NDArray[np.float64]) -> float:
    return (len(t) - 1) / float(t[-1] - t[0]) if len(t) > 1 else 100.0


def _peak(values: NDArray[np.float64]) -> float:
    return float(np.abs(values).max()) if values.size else 0.0


def _temperature(table: Table, inside: NDArray[np.bool_]) -> NDArray[np.int16]:
    if "temperature" not in table:
        return np.zeros(int(inside.sum()), np.int16)
    steps = (table["temperature"][inside] * 1e6 - _TEMPERATURE_OFFSET_UDEGC) / _TEMPERATURE_LSB_UDEGC
    return np.clip(np.rint(np.nan_to_num(steps)), -32768, 32767).astype(np.int16)
