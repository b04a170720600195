"""Samples, speeds, fixes and set poses of a log, in the blocks and order of the live run."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from hubodo.calibration.apply import find_starts
from hubodo.ingest.live.localizer import FixSample, horizontal_sigma
from hubodo.ingest.live.odometer import SpeedSample
from hubodo.log import ros2, topics
from hubodo.log.decode import ChannelDecoder, ChannelRows, normalise_type_name, parse_column_names
from hubodo.log.hubodo_messages import decode_string_message, parse_events
from hubodo.log.logfile import Log
from hubodo.log.pose_events import LoggedPose, read_poses
from hubodo.log.records import HighGSamples, ImuBlock
from hubodo.progress_callback import Progress
from hubodo.recording import HIGH_G_COLUMNS

_WHEELS_TOPIC = topics.COLUMNS_PREFIX + topics.WHEELS
_HIGH_G_PREFIX = topics.COLUMNS_PREFIX + topics.HIGH_G_PREFIX
PlayedItem = ImuBlock | HighGSamples | FixSample | LoggedPose | SpeedSample
_PLAYED_TYPES = (ros2.IMU, ros2.TEMPERATURE, ros2.BATTERY, ros2.NAV_SAT_FIX)
_NO_FIXES = ChannelDecoder(ros2.NAV_SAT_FIX).rows()


def _read_speeds(rows: ChannelRows | None, names: list[str]) -> list[tuple[int, SpeedSample]]:
    """Return the finite surface speeds of a channel with their log times."""
    if rows is None or not {"left", "right"} <= set(names) or "data" not in rows.values:
        return []
    data = rows.values["data"].reshape(len(rows), -1)[:, [names.index("left"), names.index("right")]]
    return [
        (log_ns, SpeedSample(t_ns, *pair))
        for log_ns, t_ns, pair in zip(
            rows.log_ns.tolist(), rows.publish_ns.tolist(), data.tolist(), strict=True
        )
        if np.isfinite(pair).all()
    ]


def _split_by_log_time(channel: ChannelRows) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Yield the log time and the rows of each block, rows with one log time, oldest first."""
    order = np.lexsort((channel.publish_ns, channel.log_ns))
    log_ns = channel.log_ns[order]
    edges = [0, *(np.flatnonzero(np.diff(log_ns)) + 1).tolist(), len(order)]
    for start, end in itertools.pairwise(edges):
        if end > start:
            yield int(log_ns[start]), order[start:end]


def _read_high_g(rows: Mapping[str, ChannelRows], names: Mapping[str, str]) -> list[HighGSamples]:
    """Return the finite samples of the nodes' second accelerometers by log time.

    rows, names: by topic; names: of the columns, as one text.
    """
    messages = []
    axes = HIGH_G_COLUMNS[1:]
    for topic, channel in rows.items():
        columns = parse_column_names(names.get(topic, ""))
        if not topic.startswith(_HIGH_G_PREFIX) or not set(axes) <= set(columns):
            continue
        node, data = topic.removeprefix(_HIGH_G_PREFIX), channel.values["data"].reshape(len(channel), -1)
        accel = data[:, [columns.index(axis) for axis in axes]]
        for log_ns, chosen in _split_by_log_time(channel):
            finite = chosen[np.flatnonzero(np.isfinite(accel[chosen]).all(axis=1))]
            messages.append(HighGSamples(node, channel.publish_ns[finite], log_ns, accel[finite]))
    return messages


class LoggedSamples:
    """Samples, temperatures, supply voltages and power-on times of the nodes in a log, and its fixes."""

    def __init__(self, log: Log, progress: Progress | None) -> None:
        decoders: dict[str, ChannelDecoder] = {}
        payloads: list[bytes] = []
        names: dict[str, str] = {}
        for messages in log.chunks():
            channels = messages.headers["channel"]
            for number in np.unique(channels).tolist():
                stream = log.streams.get(number)
                if stream is None:
                    continue
                chosen = np.flatnonzero(channels == number)
                kind = normalise_type_name(stream.schema)
                if stream.topic == topics.EVENTS:
                    payloads += [
                        decode_string_message(stream.encoding, messages.payload(i)) for i in chosen.tolist()
                    ]
                elif stream.encoding == "cdr" and (
                    kind in _PLAYED_TYPES
                    or stream.topic == _WHEELS_TOPIC
                    or stream.topic.startswith(_HIGH_G_PREFIX)
                ):
                    names.setdefault(stream.topic, stream.metadata.get("columns", ""))
                    decoders.setdefault(stream.topic, ChannelDecoder(kind)).feed(messages, chosen)
            if progress is not None:
                progress(f"reading {log.path.name}", log.progress)
        events, _ = parse_events(payloads)
        rows = {topic: decoder.rows() for topic, decoder in decoders.items()}
        self.nodes: dict[str, ChannelRows] = {}
        self._temperatures: dict[str, dict[int, float]] = {}
        self._supplies: dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]] = {}
        for topic, channel in rows.items():
            name = topic.removeprefix("/").removesuffix("/imu")
            if topic != topics.imu_topic(name) or not len(channel):
                continue
            samples = np.hstack([channel.values["angular_velocity"], channel.values["linear_acceleration"]])
            good = np.isfinite(samples).all(axis=1)
            if good.any():
                # Samples with NaN or infinity are gaps for the odometry.
                self.nodes[name] = channel if good.all() else channel.select(np.flatnonzero(good))
            temperatures = rows.get(topics.temperature_topic(name))
            if temperatures is not None and len(temperatures):
                pairs = zip(
                    temperatures.publish_ns.tolist(), temperatures.values["temperature"].tolist(), strict=True
                )
                self._temperatures[name] = dict(pairs)
            batteries = rows.get(topics.battery_topic(name))
            if batteries is not None and len(batteries):
                # Rounded to the millivolt of the wire format, which the log stores as float32.
                volts = np.round(batteries.values["voltage"], 3)
                order = np.argsort(batteries.publish_ns)
                self._supplies[name] = batteries.publish_ns[order], volts[order]
        self.fixes = rows.get(topics.GNSS_FIX, _NO_FIXES)
        self._poses = read_poses(events)
        self._speeds = _read_speeds(rows.get(_WHEELS_TOPIC), parse_column_names(names.get(_WHEELS_TOPIC, "")))
        self._high_g = _read_high_g(rows, names)
        self._power_on_times = {name: find_starts(events, name) for name in self.nodes}
        earliest = [int(channel.publish_ns.min()) for channel in self.nodes.values()]
        self.t_zero_ns = log.t_zero_ns if log.t_zero_ns is not None else min(earliest, default=0)

    @property
    def has_speeds(self) -> bool:
        """True if another odometer reported surface speeds."""
        return bool(self._speeds)

    def iterate(self) -> Iterator[PlayedItem]:
        """Yield blocks (samples of one node with one log time), fixes, speeds and set poses in live order."""
        cuts: list[tuple[int, str, NDArray[np.intp] | LoggedPose | SpeedSample | HighGSamples]] = [
            (log_ns, "", np.array([row]))
            for row, log_ns in enumerate(self.fixes.log_ns.tolist())
            if self.fixes.values["status.status"][row] >= 0.0
        ]
        cuts += [(pose.t_ns, "", pose) for pose in self._poses]
        cuts += [(log_ns, "", sample) for log_ns, sample in self._speeds]
        cuts += [(samples.t_log_ns, "", samples) for samples in self._high_g]
        for name, channel in self.nodes.items():
            cuts += [(log_ns, name, rows) for log_ns, rows in _split_by_log_time(channel)]
        for _, name, part in sorted(cuts, key=lambda cut: cut[:2]):
            if isinstance(part, LoggedPose | SpeedSample | HighGSamples):
                yield part
            else:
                yield self._build_block(name, part) if name else self._build_fix(int(part[0]))

    def _build_fix(self, row: int) -> FixSample:
        values = self.fixes.values
        covariance = values["position_covariance"][row]
        known = values["position_covariance_type"][row] > 0.0
        return FixSample(
            int(self.fixes.publish_ns[row]),
            float(values["latitude"][row]),
            float(values["longitude"][row]),
            horizontal_sigma(float(covariance[0]), float(covariance[4])) if known else None,
        )

    def _build_block(self, name: str, rows: NDArray[np.intp]) -> ImuBlock:
        channel = self.nodes[name]
        t_ns = channel.publish_ns[rows]
        first = int(t_ns[0])
        power_on = [since for start_ns, since in self._power_on_times[name] if start_ns <= first]
        return ImuBlock(
            name,
            channel.values["angular_velocity"][rows],
            channel.values["linear_acceleration"][rows],
            self._temperatures.get(name, {}).get(first),
            int(channel.log_ns[rows[0]]),
            t_ns=t_ns,
            power_on_ns=power_on[-1] if power_on else None,
            supply=self._voltage_at(name, first),
        )

    def _voltage_at(self, name: str, t_ns: int) -> float | None:
        """Return the newest supply voltage up to `t_ns`, V; None if unknown."""
        times_ns, volts = self._supplies.get(name, (_NO_FIXES.publish_ns, np.empty(0)))
        row = int(np.searchsorted(times_ns, t_ns, side="right")) - 1
        return float(volts[row]) if row >= 0 and np.isfinite(volts[row]) else None
