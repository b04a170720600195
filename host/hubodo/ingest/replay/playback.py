"""A log's samples through the objects of a live run again: the same blocks, in the same order."""

from __future__ import annotations

import itertools
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hubodo.calibration.apply import check_serial, find_starts
from hubodo.calibration.file import Calibration, find_node_serial
from hubodo.fuse.ranges import node_metadata
from hubodo.ingest.live.localizer import FixSample, Localizer, Located, horizontal_sigma
from hubodo.ingest.live.odometer import Block, Odometer, OdometryRows
from hubodo.ingest.replay.setup import setup_of
from hubodo.log import ros2, topics
from hubodo.log.decode import ChannelRows, Decoder, message_type
from hubodo.log.hubodo_messages import decode_string_message, parse_events
from hubodo.log.log_writer import LogWriter
from hubodo.log.logfile import Log, open_log
from hubodo.vehicle import Vehicle

Progress = Callable[[str, float], None]

_PLAYED = (ros2.IMU, ros2.TEMPERATURE, ros2.BATTERY, ros2.NAV_SAT_FIX)
_NO_FIXES = Decoder(ros2.NAV_SAT_FIX).rows()
# A header's frame id "map": its length with the ending zero, then the text. In /tf a count stands before it.
# Where the covariances of an Odometry message begin, bytes from its end.
_POSE_COVARIANCE, _TWIST_COVARIANCE = 36 * 8 + 6 * 8 + 36 * 8, 36 * 8
_FRAME_MAP = re.compile(rb"(?s).{12}(.{4})?\x04\0\0\0map\0")


class Playback:
    """The odometry of a log, made again from its samples."""

    def __init__(
        self,
        path: Path,
        *,
        vehicle: Vehicle | None = None,
        calibration: Calibration | None = None,
        progress: Progress | None = None,
    ) -> None:
        """vehicle, calibration: instead of those in the log.

        Raises LogError (no log), InputError (a vehicle without wheel nodes) and CalibrationError (the
        calibration is of another node).
        """
        with open_log(path) as log:
            self._blocks = _Blocks(log, progress)
            kept = setup_of(log)
            self.t_zero_ns = self._blocks.t_zero_ns
            metadata = log.metadata
        self.vehicle = vehicle or kept.vehicle
        self.calibration = calibration or kept.calibration
        self.odometer: Odometer | None = None
        if self.vehicle is not None:
            known = self.calibration.nodes if self.calibration is not None else {}
            for name, node in known.items():
                if name in self._blocks.nodes:
                    check_serial(name, node, find_node_serial(metadata, name))
            self.odometer = Odometer(
                self.vehicle, self.t_zero_ns, calibration=self.calibration, rate_hz=kept.rate_hz
            )
            for name in self._blocks.nodes:
                self.odometer.told(name, node_metadata(metadata, name))

    @property
    def has_fixes(self) -> bool:
        """Whether there is anything to make a map → odom from."""
        return self.odometer is not None and len(self._blocks.fixes) > 0

    def motions(self) -> Iterator[OdometryRows]:
        """Rows of /odom, block by block; nothing without a vehicle. Can be gone through once."""
        for made in self._made(None):
            if isinstance(made, OdometryRows):
                yield made

    def publications(self) -> Iterator[OdometryRows | Located]:
        """`motions` and, where the log has fixes, what the localizer makes of both."""
        antenna = self.vehicle.antenna if self.vehicle is not None else None
        return self._made(Localizer(self.t_zero_ns, antenna) if self.has_fixes else None)

    def _made(self, localizer: Localizer | None) -> Iterator[OdometryRows | Located]:
        odometer = self.odometer
        if odometer is None:
            return
        for item in itertools.chain(self._blocks.in_order(), [None]):
            if isinstance(item, FixSample):
                if localizer is not None:
                    localizer.fix(item)
                continue
            yield from odometer.finish() if item is None else odometer.handle(item)
            for pose in odometer.fresh():
                located = localizer.odometry(pose) if localizer is not None else None
                if located is not None:
                    yield located


def recorded_messages(path: Path, *, on_map: bool = True) -> dict[str, list[tuple[int, bytes]]]:
    """The messages of /odom, /odom_map and /tf in a log: (publish time ns, bytes), by publish time.

    on_map: false leaves out what is in the frame map.
    """
    found: dict[str, list[tuple[int, bytes]]] = {topics.ODOM: [], topics.ODOM_MAP: [], topics.TF: []}
    with open_log(path) as log:
        for message in log.messages(list(found)):
            if on_map or not _FRAME_MAP.match(message.data):
                data = message.data if message.topic == topics.TF else _without_unknown(message.data)
                found[message.topic].append((message.publish_time, data))
    for rows in found.values():
        rows.sort()
    return found


def _without_unknown(odometry: bytes) -> bytes:
    """An Odometry message with zeros for the variances of what nobody measures, as earlier logs had them."""
    made = bytearray(odometry)
    for end, places in ((_POSE_COVARIANCE, (14, 21, 28)), (_TWIST_COVARIANCE, (7, 14, 21, 28))):
        for place in places:
            begin = len(made) - end + 8 * place
            made[begin : begin + 8] = bytes(8)
    return bytes(made)


def as_messages(
    publications: Iterable[OdometryRows | Located], t_zero_ns: int
) -> dict[str, list[tuple[int, bytes]]]:
    """What was made as the messages that a recording would hold, in the form of `recorded_messages`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "again.mcap")
        with LogWriter(path, t_zero_ns=t_zero_ns, compression="none", clock=None) as log:
            for made in publications:
                made.write(log, int(made.t_ns[-1]))
        return recorded_messages(path)


class _Blocks:
    """Samples, temperatures, supplies and starts of the nodes of a log, and its fixes."""

    def __init__(self, log: Log, progress: Progress | None) -> None:
        decoders: dict[str, Decoder] = {}
        payloads: list[bytes] = []
        for messages in log.chunks():
            channels = messages.heads["channel"]
            for number in np.unique(channels).tolist():
                stream = log.streams.get(number)
                if stream is None:
                    continue
                chosen = np.flatnonzero(channels == number)
                kind = message_type(stream.schema)
                if stream.topic == topics.EVENTS:
                    payloads += [
                        decode_string_message(stream.encoding, messages.payload(i)) for i in chosen.tolist()
                    ]
                elif stream.encoding == "cdr" and kind in _PLAYED:
                    decoders.setdefault(stream.topic, Decoder(kind)).feed(messages, chosen)
            if progress is not None:
                progress(f"reading {log.path.name}", log.progress)
        events, _ = parse_events(payloads)
        rows = {topic: decoder.rows() for topic, decoder in decoders.items()}
        self.nodes: dict[str, ChannelRows] = {}
        self._temperatures: dict[str, dict[int, float]] = {}
        self._supplies: dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]] = {}
        for topic, found in rows.items():
            name = topic.removeprefix("/").removesuffix("/imu")
            if topic != topics.imu_topic(name) or not len(found):
                continue
            samples = np.hstack([found.values["angular_velocity"], found.values["linear_acceleration"]])
            good = np.isfinite(samples).all(axis=1)
            if good.any():
                # NaN and infinity are gaps to the odometry.
                self.nodes[name] = found if good.all() else found.take(np.flatnonzero(good))
            warm = rows.get(topics.temperature_topic(name))
            if warm is not None and len(warm):
                pairs = zip(warm.publish_ns.tolist(), warm.values["temperature"].tolist(), strict=True)
                self._temperatures[name] = dict(pairs)
            fed = rows.get(topics.battery_topic(name))
            if fed is not None and len(fed):
                # As a node tells it, to the millivolt, before it was a float32.
                volts = np.round(fed.values["voltage"], 3)
                order = np.argsort(fed.publish_ns)
                self._supplies[name] = fed.publish_ns[order], volts[order]
        self.fixes = rows.get(topics.GNSS_FIX, _NO_FIXES)
        self._starts = {name: find_starts(events, name) for name in self.nodes}
        earliest = [int(found.publish_ns.min()) for found in self.nodes.values()]
        self.t_zero_ns = log.t_zero_ns if log.t_zero_ns is not None else min(earliest, default=0)

    def in_order(self) -> Iterator[Block | FixSample]:
        """Blocks: what has one log time and one node came together; fixes between them as they came."""
        cuts = [
            (log_ns, "", np.array([row]))
            for row, log_ns in enumerate(self.fixes.log_ns.tolist())
            if self.fixes.values["status.status"][row] >= 0.0
        ]
        for name, found in self.nodes.items():
            order = np.lexsort((found.publish_ns, found.log_ns))
            log_ns = found.log_ns[order]
            edges = [0, *(np.flatnonzero(np.diff(log_ns)) + 1).tolist(), len(order)]
            for begin, end in itertools.pairwise(edges):
                cuts.append((int(log_ns[begin]), name, order[begin:end]))
        for _, name, rows in sorted(cuts, key=lambda cut: cut[:2]):
            yield self._block(name, rows) if name else self._fix(int(rows[0]))

    def _fix(self, row: int) -> FixSample:
        values = self.fixes.values
        covariance = values["position_covariance"][row]
        known = values["position_covariance_type"][row] > 0.0
        return FixSample(
            int(self.fixes.publish_ns[row]),
            float(values["latitude"][row]),
            float(values["longitude"][row]),
            horizontal_sigma(float(covariance[0]), float(covariance[4])) if known else None,
        )

    def _block(self, name: str, rows: NDArray[np.intp]) -> Block:
        found = self.nodes[name]
        t_ns = found.publish_ns[rows]
        first = int(t_ns[0])
        power_on = [since for begun, since in self._starts[name] if begun <= first]
        return Block(
            name,
            t_ns,
            found.values["angular_velocity"][rows],
            found.values["linear_acceleration"][rows],
            self._temperatures.get(name, {}).get(first),
            power_on[-1] if power_on else None,
            self._supply(name, first),
        )

    def _supply(self, name: str, t_ns: int) -> float | None:
        """V, as it was measured last up to t_ns."""
        told_ns, volts = self._supplies.get(name, (_NO_FIXES.publish_ns, np.empty(0)))
        place = int(np.searchsorted(told_ns, t_ns, side="right")) - 1
        return float(volts[place]) if place >= 0 and np.isfinite(volts[place]) else None
