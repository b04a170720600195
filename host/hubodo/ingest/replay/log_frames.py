"""Frames of a log: recorded frames, or frames synthesised from samples where none were recorded."""

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

_MAX_RAW_VALUE = 32767
_TEMPERATURE_LSB_UDEGC, _TEMPERATURE_OFFSET_UDEGC = 3_906, 25_000_000
_MAX_BATCH_SAMPLES = 16
_MAX_SPACING_ERROR_S = 20e-6  # deviation from evenly spaced times; a larger one starts a new batch
_ANSWER_TYPES = (Ack.type_id, Nack.type_id, TimeReply.type_id)


@dataclass(frozen=True, slots=True)
class TimedFrame:
    """Bytes of a frame with delimiter; t: s on the log's time scale; frame: None if damaged."""

    t: float
    data: bytes
    frame: Frame | None


@dataclass(frozen=True, slots=True)
class Quantisation:
    """Quantisation errors of frames synthesised for one node.

    gyro_step: rad/s, accel_step: m/s²: values change by at most half a step. time_error: maximum, s.
    has_temperature: False if 25 °C is sent because the samples have no temperature.
    """

    node: str
    node_id: int
    gyro_step: float
    accel_step: float
    time_error: float
    has_temperature: bool


def raw_links(log: Log) -> list[str]:
    """Return the labels of links with raw frames in a log."""
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
    """Yield the recorded frames of links, including damaged ones, by time of arrival.

    Answers to requests of the recording host are omitted, because the present host sends its own. Raises
    InputError when two links carry one node id, because they cannot share a line.
    """
    owners: dict[int, str] = {}
    wanted = [RAW_PREFIX + link + tail for link in links for tail in ("", "/damaged")]
    bounds = [None if t is None else t_zero_ns + round(t * 1e9) for t in (start, end)]
    splitter, streams = FrameDecoder(), log.streams
    for message in log.messages(wanted, *bounds):
        data = decode_bytes_message(streams[message.channel].encoding, message.data)
        stuffed = data.rstrip(b"\0")
        frame = splitter.decode_frame(stuffed) if stuffed else None
        if frame is not None and frame.type_id in _ANSWER_TYPES:
            continue
        if frame is not None:
            link = message.topic.removeprefix(RAW_PREFIX)
            owner = owners.setdefault(frame.node, link)
            if owner != link:
                raise InputError(
                    f"links {owner} and {link} both carry node id {frame.node}; choose one with --only"
                )
        yield TimedFrame((message.log_time - t_zero_ns) * 1e-9, data, frame)


def synthesise_frames(
    recording: Recording, start: float | None, end: float | None
) -> tuple[Iterator[TimedFrame], list[Quantisation]]:
    """Return frames synthesised from the samples of a recording, with the finest steps that 16 bits allow.

    Raises InputError when the recording has no node.
    """
    if not recording.nodes:
        raise InputError("the log holds neither frames nor nodes; there is nothing to play to a port")
    ids = _assign_ids(recording.nodes)
    synthesisers = [
        _FrameSynthesiser(name, ids[name], table, start, end) for name, table in recording.nodes.items()
    ]
    frames = heapq.merge(*(maker.frames() for maker in synthesisers), key=attrgetter("t"))
    return frames, [maker.quantisation for maker in synthesisers]


def _assign_ids(names: Iterable[str]) -> dict[str, int]:
    """Return node ids: left 1, right 2, frame 3, others from 4 in order."""
    others = (number for number in itertools.count(1) if number not in NODE_IDS.values())
    return {name: NODE_IDS[name] if name in NODE_IDS else next(others) for name in names}


class _FrameSynthesiser:
    """Synthesises the frames of one node."""

    def __init__(self, name: str, node_id: int, table: Table, start: float | None, end: float | None) -> None:
        inside = np.ones(len(table), bool)
        if start is not None:
            inside &= table.t >= start
        if end is not None:
            inside &= table.t < end
        self._id = node_id
        self._t = table.t[inside]
        gyro, accel = table.gyro[inside], table.accel[inside]
        gyro_ndps = max(1, math.ceil(_peak(gyro) / RAD_PER_NANO_DEG / _MAX_RAW_VALUE))
        accel_ng = max(1, math.ceil(_peak(accel) / (1e-9 * STANDARD_GRAVITY) / _MAX_RAW_VALUE))
        gyro_step, accel_step = gyro_ndps * RAD_PER_NANO_DEG, accel_ng * 1e-9 * STANDARD_GRAVITY
        self._raw = np.rint(np.hstack([gyro / gyro_step, accel / accel_step])).astype(np.int16)
        self._temperature = _quantise_temperature(table, inside)
        self._ends = _split_batches(self._t)
        self._hello = Hello(
            FINGERPRINT,
            (0, 0, 0),
            name.encode("ascii", "replace")[:8].ljust(8, b"\0"),
            1,
            0,
            0,
            round(1e3 * _mean_rate(self._t)),
            min(65535, math.ceil(gyro_ndps * 1e-9 * _MAX_RAW_VALUE)),
            min(255, math.ceil(accel_ng * 1e-9 * _MAX_RAW_VALUE)),
            gyro_ndps,
            accel_ng,
            _TEMPERATURE_LSB_UDEGC,
            _TEMPERATURE_OFFSET_UDEGC,
            0,
            _MAX_BATCH_SAMPLES,
            0,
            min(65534, math.ceil(1e6 * self._time_error())),
        )
        self.quantisation = Quantisation(
            name, node_id, gyro_step, accel_step, self._time_error(), "temperature" in table
        )

    def frames(self) -> Iterator[TimedFrame]:
        """Yield a Hello, then the batches, each at the time of its last sample."""
        if not len(self._t):
            return
        yield self._build_frame(float(self._t[0]), self._hello, 0)
        first = 0
        for seq, end in enumerate(self._ends):
            rows = tuple(map(tuple, self._raw[first:end].tolist()))
            t_us, period_ns = self._timing(first, end)
            batch = ImuBatch(
                t_us % (1 << 30), period_ns, first & 0xFFFF, int(self._temperature[first]), 0, rows
            )
            yield self._build_frame(float(self._t[end - 1]), batch, seq)
            first = end

    def _timing(self, first: int, end: int) -> tuple[int, int]:
        t_us = round((self._t[first] - self._t[0]) * 1e6)
        if end - first > 1:
            return t_us, round((self._t[end - 1] - self._t[first]) / (end - first - 1) * 1e9)
        return t_us, round(1e9 / _mean_rate(self._t))

    def _build_frame(self, t: float, message: Hello | ImuBatch, seq: int) -> TimedFrame:
        frame = Frame(message.type_id, self._id, seq & 0xFFFF, encode(message))
        return TimedFrame(t, encode_frame(frame), frame)

    def _time_error(self) -> float:
        worst, first = 0.0, 0
        for end in self._ends:
            t_us, period_ns = self._timing(first, end)
            batch_times = self._t[0] + t_us * 1e-6 + period_ns * 1e-9 * np.arange(end - first)
            worst = max(worst, float(np.abs(batch_times - self._t[first:end]).max()))
            first = end
        return worst


def _split_batches(t: NDArray[np.float64]) -> list[int]:
    """Return the ends of batches whose sample times are evenly spaced within the tolerance."""
    ends, first = [], 0
    while first < len(t):
        size = min(_MAX_BATCH_SAMPLES, len(t) - first)
        while size > 2:
            part = t[first : first + size]
            even = np.linspace(part[0], part[-1], size)
            if float(np.abs(part - even).max()) <= _MAX_SPACING_ERROR_S:
                break
            size //= 2
        first += size
        ends.append(first)
    return ends


def _mean_rate(t: NDArray[np.float64]) -> float:
    return (len(t) - 1) / float(t[-1] - t[0]) if len(t) > 1 else 100.0


def _peak(values: NDArray[np.float64]) -> float:
    return float(np.abs(values).max()) if values.size else 0.0


def _quantise_temperature(table: Table, inside: NDArray[np.bool_]) -> NDArray[np.int16]:
    if "temperature" not in table:
        return np.zeros(int(inside.sum()), np.int16)
    steps = (table["temperature"][inside] * 1e6 - _TEMPERATURE_OFFSET_UDEGC) / _TEMPERATURE_LSB_UDEGC
    return np.clip(np.rint(np.nan_to_num(steps)), -32768, 32767).astype(np.int16)
