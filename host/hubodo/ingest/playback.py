"""A log's samples through the objects of a live run again: the same blocks, in the same order."""

from __future__ import annotations

import itertools
import tempfile
import tomllib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hubodo.config import Vehicle, vehicle_of
from hubodo.errors import ConfigError
from hubodo.ingest.odometer import Block, Motion, Odometer
from hubodo.log import ros2, topics
from hubodo.log.decode import Decoder, Rows, message_type
from hubodo.log.logfile import Log, open_log
from hubodo.log.mcap import events_of
from hubodo.log.writer import McapLog
from hubodo.sensors.apply import check_serial, power_on_times
from hubodo.sensors.calibration import Calibration, node_serial, parse_calibration

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Setup:
    """What the odometry of a log was made with. vehicle: None where the log does not tell. rate_hz: poses a
    second at most."""

    vehicle: Vehicle | None
    calibration: Calibration | None
    rate_hz: float | None


def setup_of(log: Log) -> Setup:
    """Vehicle, calibration and rate that a log carries. Raises ConfigError when they make no sense."""
    files = log.attachments
    vehicle = calibration = None
    if "vehicle.toml" in files:
        where = f"{log.path}: vehicle.toml"
        try:
            vehicle = vehicle_of(tomllib.loads(files["vehicle.toml"].decode()), where)
        except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise ConfigError(f"{where}: not TOML: {error}; give --vehicle") from None
    if "calibration.toml" in files:
        text = files["calibration.toml"].decode("utf-8", "replace")
        calibration = parse_calibration(text, Path(f"{log.path}: calibration.toml"))
    rate = log.metadata.get("odometry_rate_hz")
    return Setup(vehicle, calibration, float(rate) if rate else None)


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
                    check_serial(name, node, node_serial(metadata, name))
            self.odometer = Odometer(
                self.vehicle, self.t_zero_ns, calibration=self.calibration, rate_hz=kept.rate_hz
            )

    def blocks(self) -> Iterator[Block]:
        """The samples of the log in the order in which they came."""
        return self._blocks.in_order()

    def motions(self) -> Iterator[Motion]:
        """Rows of /odom, block by block; nothing without a vehicle. Can be gone through once."""
        if self.odometer is None:
            return
        for block in self.blocks():
            yield from self.odometer.handle(block)
        yield from self.odometer.finish()


def recorded_messages(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    """The messages of /odom and /tf in a log: (publish time ns, bytes), by publish time."""
    found: dict[str, list[tuple[int, bytes]]] = {topics.ODOM: [], topics.TF: []}
    with open_log(path) as log:
        for message in log.messages(list(found)):
            found[message.topic].append((message.publish_time, message.data))
    for rows in found.values():
        rows.sort(key=lambda row: row[0])
    return found


def as_messages(motions: Iterable[Motion], t_zero_ns: int) -> dict[str, list[tuple[int, bytes]]]:
    """Motions as the messages that a recording would hold, in the form of `recorded_messages`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "again.mcap")
        with McapLog(path, t_zero_ns=t_zero_ns, compression="none", clock=None) as log:
            for motion in motions:
                motion.write(log, int(motion.t_ns[-1]))
        return recorded_messages(path)


class _Blocks:
    """Samples, temperatures and starts of the nodes of a log."""

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
                    payloads += [messages.payload(i) for i in chosen.tolist()]
                elif stream.encoding == "cdr" and kind in (ros2.IMU, ros2.TEMPERATURE):
                    decoders.setdefault(stream.topic, Decoder(kind)).feed(messages, chosen)
            if progress is not None:
                progress(f"reading {log.path.name}", log.progress)
        events, _ = events_of(payloads)
        rows = {topic: decoder.rows() for topic, decoder in decoders.items()}
        self.nodes: dict[str, Rows] = {}
        self._temperatures: dict[str, dict[int, float]] = {}
        for topic, found in rows.items():
            name = topic.removeprefix("/").removesuffix("/imu")
            if topic != topics.imu(name) or not len(found):
                continue
            self.nodes[name] = found
            warm = rows.get(topics.temperature(name))
            if warm is not None and len(warm):
                pairs = zip(warm.publish_ns.tolist(), warm.values["temperature"].tolist(), strict=True)
                self._temperatures[name] = dict(pairs)
        self._starts = {name: power_on_times(events, name) for name in self.nodes}
        earliest = [int(found.publish_ns.min()) for found in self.nodes.values()]
        self.t_zero_ns = log.t_zero_ns if log.t_zero_ns is not None else min(earliest, default=0)

    def in_order(self) -> Iterator[Block]:
        """Blocks: what has one log time and one node came together."""
        cuts = []
        for name, found in self.nodes.items():
            order = np.lexsort((found.publish_ns, found.log_ns))
            log_ns = found.log_ns[order]
            edges = [0, *(np.flatnonzero(np.diff(log_ns)) + 1).tolist(), len(order)]
            for begin, end in itertools.pairwise(edges):
                cuts.append((int(log_ns[begin]), name, order[begin:end]))
        for _, name, rows in sorted(cuts, key=lambda cut: cut[:2]):
            yield self._block(name, rows)

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
        )
