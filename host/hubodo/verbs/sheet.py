"""`hubodo sheet`: test sheet of one sensor, with the files for kalibr and for its node."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from hubodo.atomic_files import atomic_folder
from hubodo.calibration.file import (
    Calibration,
    find_node_serial,
    find_temperature_span,
    hash_source,
    read_calibration,
    write_calibration,
)
from hubodo.errors import HubodoError, InputError
from hubodo.log.pose_table import read_pose_table
from hubodo.log.units import si_factor
from hubodo.progress import progress_line
from hubodo.recording import Recording
from hubodo.report.sensor_sheet import SensorSheet, SheetRecord
from hubodo.sensors.allan.characterise import characterise_standstill_noise
from hubodo.sensors.allan.noise_files import NOISE_CHANNELS, kalibr_yaml
from hubodo.sensors.imu.node_imu import ImuOptions, calibrate_node_imu
from hubodo.sensors.imu.pose_means import DEFAULT_NODE, calibrate_pose_means
from hubodo.sensors.standstill_channel import StandstillRecord, read_standstill_channel
from hubodo.sensors.warmup.characterise import characterise_standstill_warmup
from hubodo.verbs.calibrate_imu import calibrated_effects
from hubodo.verbs.log_options import add_log_options, stated_input_format
from hubodo.verbs.numbers import latitude, non_negative_number, positive_number
from hubodo.verbs.outputs import add_force_option, add_units_option
from hubodo.verbs.standstill import read_node
from hubodo.verbs.warmup import extend_calibration

EXAMPLE = "hubodo sheet --still night.mcap --warmup cold.mcap --poses poses.mcap --node left -o sheet"

SHEET, KALIBR, CALIBRATION = "sheet.html", "imu.yaml", "calibration.toml"
_WARMUP_CHANNELS = NOISE_CHANNELS[:3]


@dataclass(frozen=True)
class SheetResult:
    """The files of a sheet, and what could not be determined.

    Attributes
    ----------
    node : name of the node.
    folder : the folder with the files.
    files : their names.
    sheet : what the page shows.
    """

    node: str
    folder: str
    files: tuple[str, ...]
    sheet: SensorSheet

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result: files, and the results of each part as its own verb gives them."""
        sheet = self.sheet
        return {
            "node": self.node,
            "files": [str(Path(self.folder) / name) for name in self.files],
            "noise": {it.channel: it.as_json() for it in sheet.noise},
            "warmup": {it.channel: it.as_json() for it in sheet.warmups},
            "calibration": None if sheet.calibration is None else sheet.calibration.as_json(),
            "notes": list(sheet.notes),
        }

    def render(self, console: Console) -> None:
        """Print the files and the notes."""
        for name in self.files:
            console.print(str(Path(self.folder) / name), highlight=False, markup=False, soft_wrap=True)
        for text in self.sheet.notes:
            console.print(f"note: {text}", highlight=False, markup=False, soft_wrap=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo sheet`."""
    parser.add_argument(
        "--still",
        type=Path,
        metavar="LOG",
        help="log of the stationary sensor: Allan deviation of six channels",
    )
    parser.add_argument(
        "--warmup", type=Path, metavar="LOG", help="log from power-on: warm-up of three gyro axes"
    )
    parser.add_argument(
        "--poses", type=Path, metavar="LOG", help="log of nine or more static poses: calibration"
    )
    parser.add_argument(
        "--means", action="store_true", help="--poses is a table of pose means, as of hubodo calibrate imu"
    )
    parser.add_argument("--node", help="name of the node (default: the only one)")
    parser.add_argument(
        "--age",
        type=non_negative_number,
        default=0.0,
        help="time since power-on at the first sample of --warmup, s (default 0)",
    )
    parser.add_argument(
        "--gravity", type=positive_number, default=9.80665, help="local gravity, m/s² (default 9.80665)"
    )
    parser.add_argument(
        "--latitude-deg", type=latitude, help="latitude; makes Earth rate the reference of precise gyros"
    )
    add_log_options(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="FOLDER",
        help=f"folder to write {SHEET}, {KALIBR} and {CALIBRATION} into",
    )
    add_units_option(parser)
    add_force_option(parser, "output", own_files=(SHEET, KALIBR, CALIBRATION))


def run(args: argparse.Namespace) -> SheetResult:
    """Analyse each record, and write the sheet and the files for other programs.

    Returns
    -------
    SheetResult
        The files, the results of each part, and notes on what could not be determined.

    Raises
    ------
    InputError
        If no record is given, or one does not suffice for its part.
    """
    if not (args.still or args.warmup or args.poses):
        raise InputError("a sheet needs at least one of --still, --warmup and --poses")
    if args.means and args.poses is None:
        raise InputError("--means belongs to --poses, the table of pose means")
    builder = _SheetBuilder(args)
    parts = [
        (builder.read(purpose, log), log, add)
        for purpose, log, add in (
            ("standstill", args.still, builder.add_noise),
            ("warm-up", args.warmup, builder.add_warmup),
            ("poses", None if args.means else args.poses, builder.add_poses),
        )
        if log is not None
    ]
    for recording, log, add in parts:
        add(recording, log)
    if args.means:
        builder.add_means(args.poses)
    with atomic_folder(args.output) as part:
        files = builder.write(part)
    return SheetResult(builder.node, str(args.output), files, builder.sheet())


class _SheetBuilder:
    """Analyses the records of one node, and collects the parts of its sheet."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._args = args
        self.node = args.node or ""
        self._identity: dict[str, str] = {}
        self._parts: dict[str, Any] = {"noise": [], "warmups": [], "calibration": None, "kalibr": ""}
        self._records: list[SheetRecord] = []
        self._sha256: dict[str, str] = {}
        self._notes: list[str] = []
        self._standstills: list[tuple[StandstillRecord, str]] = []
        self._effects: Mapping[str, Any] = {}
        self._serial = ""

    def read(self, purpose: str, log: Path) -> Recording:
        """Read a log, check that it is of the same sensor as those before, and note its facts."""
        recording, node = read_node(log, self.node or None, stated_input_format(self._args, needed=()))
        serial = find_node_serial(recording.metadata, node)
        if self._serial and serial and serial != self._serial:
            raise InputError(f"{log}: is of the node with serial {serial}, the log before of {self._serial}")
        self.node, self._serial = node, serial or self._serial
        table = recording.nodes[node]
        self._sha256[purpose] = hash_source(log)
        self._records.append(
            SheetRecord(
                purpose,
                log.name,
                self._sha256[purpose],
                float(table.t[-1] - table.t[0]),
                1.0 / float(np.median(np.diff(table.t))),
                find_temperature_span(table),
            )
        )
        self._identity["node"] = node
        for name, key in (("chips", "parts"), ("serial", "serial"), ("firmware", "firmware")):
            if text := recording.metadata.get(f"node.{node}.{key}"):
                self._identity[name] = text
        return recording

    def add_noise(self, recording: Recording, log: Path) -> None:
        """Add the Allan deviation of all six channels, and the file for kalibr."""
        with progress_line() as show:
            for number, channel in enumerate(NOISE_CHANNELS):
                show(f"noise of {channel}", number / len(NOISE_CHANNELS))
                record = self._standstill(recording, log, channel, cut=True)
                self._parts["noise"].append(characterise_standstill_noise(record))
        try:
            self._parts["kalibr"] = kalibr_yaml(self._parts["noise"])
        except InputError as error:
            self._notes.append(f"{KALIBR} is not written: {error}.")

    def add_warmup(self, recording: Recording, log: Path) -> None:
        """Add the warm-up of the three gyro axes."""
        with progress_line() as show:
            for number, channel in enumerate(_WARMUP_CHANNELS):
                show(f"warm-up of {channel}", number / len(_WARMUP_CHANNELS))
                record = self._standstill(recording, log, channel)
                self._parts["warmups"].append(characterise_standstill_warmup(record, age=self._args.age))
                self._standstills.append((record, self._sha256["warm-up"]))

    def add_poses(self, recording: Recording, log: Path) -> None:
        """Add the calibration of both triads."""
        table, args = recording.nodes[self.node], self._args
        with progress_line() as show:
            show("detecting static poses and turns", 0.5)
            try:
                calibration = calibrate_node_imu(
                    table, self.node, str(log), ImuOptions(args.gravity, args.latitude_deg)
                )
            except HubodoError as error:
                raise type(error)(f"{log}: {error}") from error
        self._parts["calibration"] = calibration
        self._effects = calibrated_effects(calibration, table, self._sha256["poses"])

    def add_means(self, path: Path) -> None:
        """Add the calibration from a table of pose means, which names no node."""
        args = self._args
        self.node = self.node or DEFAULT_NODE
        digest = hash_source(path)
        table = read_pose_table(path, stated_input_format(args, needed=()))
        options = ImuOptions(args.gravity, args.latitude_deg)
        calibration = calibrate_pose_means(table, self.node, str(path), options, {})
        self._records.append(SheetRecord("means of poses", path.name, digest, None, None, None))
        self._identity["node"] = self.node
        self._parts["calibration"] = calibration
        self._effects = calibrated_effects(calibration, None, digest)

    def sheet(self) -> SensorSheet:
        """Return the sheet."""
        return SensorSheet(
            self.node, list(self._identity.items()), self._records, notes=self._notes, **self._parts
        )

    def write(self, folder: Path) -> tuple[str, ...]:
        """Write all files into a folder, and return their names."""
        path = folder / CALIBRATION
        for result, (record, digest) in zip(self._parts["warmups"], self._standstills, strict=True):
            if result.accepted is None:
                continue
            try:
                extend_calibration(path, result, record, digest)
            except InputError as error:
                self._notes.append(f"{CALIBRATION} lacks the warm-up of {result.channel}: {error}.")
        if self._effects:
            before = read_calibration(path) if path.exists() else Calibration()
            write_calibration(before.with_node(self.node, self._effects, self._serial), path)
        if self._parts["kalibr"]:
            (folder / KALIBR).write_text(self._parts["kalibr"], "utf-8")
        (folder / SHEET).write_text(self.sheet().html(), "utf-8")
        return tuple(name for name in (SHEET, KALIBR, CALIBRATION) if (folder / name).exists())

    def _standstill(
        self, recording: Recording, log: Path, channel: str, *, cut: bool = False
    ) -> StandstillRecord:
        return read_standstill_channel(
            recording,
            self.node,
            channel,
            log=str(log),
            stated_units=frozenset(si_factor(unit)[0] for unit in self._args.unit),
            cut_disturbances=cut,
        )
