"""Playback of a log's samples through odometer and localizer, in the blocks and order of the live run."""

from __future__ import annotations

import itertools
import re
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from hubodo.calibration.apply import check_serial
from hubodo.calibration.file import Calibration, find_node_serial
from hubodo.fuse.ranges import node_metadata
from hubodo.ingest.live.localizer import FixSample, Localizer, MapPose
from hubodo.ingest.live.odometer import Odometer, SpeedSample
from hubodo.ingest.live.odometry_rows import OdometryRows
from hubodo.ingest.replay.logged_samples import LoggedSamples
from hubodo.ingest.replay.odometry_setup import read_odometry_setup
from hubodo.log import topics
from hubodo.log.log_writer import LogWriter
from hubodo.log.logfile import open_log
from hubodo.log.pose_events import LoggedPose
from hubodo.progress_callback import Progress
from hubodo.vehicle import Vehicle

# Start of the covariances in an Odometry message, bytes from its end.
_POSE_COVARIANCE_OFFSET, _TWIST_COVARIANCE_OFFSET = 36 * 8 + 6 * 8 + 36 * 8, 36 * 8
_MAP_FRAME = re.compile(rb"(?s).{12}(.{4})?\x04\0\0\0map\0")


class Playback:
    """The odometry of a log, recomputed from its samples."""

    def __init__(
        self,
        path: Path,
        *,
        vehicle: Vehicle | None = None,
        calibration: Calibration | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Read the samples of a log; vehicle, calibration: replace those in the log.

        Raises LogError for an invalid log, InputError for a vehicle without wheel nodes, CalibrationError for
        a calibration of another node.
        """
        with open_log(path) as log:
            self._samples = LoggedSamples(log, progress)
            setup = read_odometry_setup(log)
            self.t_zero_ns = self._samples.t_zero_ns
            metadata = log.metadata
        self.vehicle = vehicle or setup.vehicle
        self.calibration = calibration or setup.calibration
        self.odometer: Odometer | None = None
        if self.vehicle is not None:
            known = self.calibration.nodes if self.calibration is not None else {}
            for name, node in known.items():
                if name in self._samples.nodes:
                    check_serial(name, node, find_node_serial(metadata, name))
            self.odometer = Odometer(
                self.vehicle,
                self.t_zero_ns,
                calibration=self.calibration,
                rate_hz=setup.rate_hz,
                encoder_aided=self._samples.has_speeds,
            )
            for name in self._samples.nodes:
                self.odometer.update_ranges(name, node_metadata(metadata, name))

    @property
    def has_fixes(self) -> bool:
        """True if map → odom can be computed: there are odometry and fixes."""
        return self.odometer is not None and len(self._samples.fixes) > 0

    def odometry_rows(self) -> Iterator[OdometryRows]:
        """Yield the rows of /odom block by block; nothing without a vehicle. Can be iterated once."""
        for publication in self._play(None):
            if isinstance(publication, OdometryRows):
                yield publication

    def publications(self) -> Iterator[OdometryRows | MapPose]:
        """Return `odometry_rows` and, if the log has fixes, the poses of the localizer on the map."""
        return self._play(Localizer(self.t_zero_ns, self.vehicle) if self.has_fixes else None)

    def _play(self, localizer: Localizer | None) -> Iterator[OdometryRows | MapPose]:
        odometer = self.odometer
        if odometer is None:
            return
        for item in itertools.chain(self._samples.iterate(), [None]):
            if isinstance(item, FixSample):
                if localizer is not None:
                    localizer.add_fix(item)
                continue
            if isinstance(item, SpeedSample):
                odometer.add_surface_speeds(item)
                continue
            if isinstance(item, LoggedPose):
                odometer.set_pose(*item.pose, np.array(item.covariance, np.float64))
                continue
            yield from odometer.finish() if item is None else odometer.handle(item)
            for pose in odometer.take_poses():
                located = localizer.add_pose(pose) if localizer is not None else None
                if located is not None:
                    yield located


def recorded_messages(path: Path, *, include_map: bool = True) -> dict[str, list[tuple[int, bytes]]]:
    """Return the messages of /odom, /odom_map and /tf in a log as (publish time ns, bytes), sorted.

    include_map: False to omit messages in the frame map.
    """
    messages: dict[str, list[tuple[int, bytes]]] = {topics.ODOM: [], topics.ODOM_MAP: [], topics.TF: []}
    with open_log(path) as log:
        for message in log.messages(list(messages)):
            if include_map or not _MAP_FRAME.match(message.data):
                data = message.data if message.topic == topics.TF else _zero_unmeasured(message.data)
                messages[message.topic].append((message.publish_time, data))
    for rows in messages.values():
        rows.sort()
    return messages


def _zero_unmeasured(odometry: bytes) -> bytes:
    """Return an Odometry message with zeros for unmeasured variances, as in logs of earlier versions."""
    message = bytearray(odometry)
    for end, elements in (
        (_POSE_COVARIANCE_OFFSET, (14, 21, 28)),
        (_TWIST_COVARIANCE_OFFSET, (7, 14, 21, 28)),
    ):
        for element in elements:
            start = len(message) - end + 8 * element
            message[start : start + 8] = bytes(8)
    return bytes(message)


def to_messages(
    publications: Iterable[OdometryRows | MapPose], t_zero_ns: int
) -> dict[str, list[tuple[int, bytes]]]:
    """Return publications as the messages of a log, in the form of `recorded_messages`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "again.mcap")
        with LogWriter(path, t_zero_ns=t_zero_ns, compression="none", clock=None) as log:
            for publication in publications:
                publication.write(log, int(publication.t_ns[-1]))
        return recorded_messages(path)
