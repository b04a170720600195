"""Test sheet of one sensor: noise, warm-up and calibration on two printed pages."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

from hubodo.calibration.parameter_table import parameter_headings
from hubodo.pages.drawing import render_drawing
from hubodo.pages.page import PageTable, Section, render_page
from hubodo.sensors.allan.figure import allan_figure
from hubodo.sensors.allan.ieee952 import is_gyro
from hubodo.sensors.allan.page import comparison_table
from hubodo.sensors.allan.result import AllanResult
from hubodo.sensors.imu.page import imu_verdict, parameter_rows
from hubodo.sensors.imu.pose_plan import (
    PLANNED_BIAS_SIGMA,
    PLANNED_TURN_S,
    noise_of_accelerometers,
    plan_poses,
)
from hubodo.sensors.imu.result import ImuCalibration
from hubodo.sensors.warmup.page import parameter_headings as warmup_headings
from hubodo.sensors.warmup.page import parameter_rows as warmup_rows
from hubodo.sensors.warmup.page import summarise_warmup
from hubodo.sensors.warmup.result import WarmupResult
from hubodo.unit_systems import unit_system

RECORD_HEADINGS = ("record", "file", "SHA-256", "duration, s", "rate, Hz", "temperature, °C")


@dataclass(frozen=True)
class SheetRecord:
    """A log that a part of the sheet was computed from.

    Attributes
    ----------
    purpose : standstill, warm-up or poses.
    file : its name.
    sha256 : hash of its content.
    duration : s; None for a table of pose means.
    rate_hz : median sample rate, likewise.
    temperature : lowest and highest, °C; None without a thermometer.
    """

    purpose: str
    file: str
    sha256: str
    duration: float | None
    rate_hz: float | None
    temperature: tuple[float, float] | None

    def row(self) -> tuple[str, ...]:
        """Return the record as a row of RECORD_HEADINGS."""
        span = "not measured" if self.temperature is None else "{:.1f} to {:.1f}".format(*self.temperature)
        duration = "" if self.duration is None else f"{self.duration:.0f}"
        rate = "" if self.rate_hz is None else f"{self.rate_hz:.4g}"
        return (self.purpose, self.file, self.sha256[:16], duration, rate, span)


@dataclass(frozen=True)
class SensorSheet:
    """The content of the sheet of one node; a part without a record is empty.

    Attributes
    ----------
    node : name of the node.
    identity : rows of name and value: chip, serial, firmware.
    records : the logs.
    noise : Allan deviation of each channel.
    warmups : warm-up of each gyro axis.
    calibration : from poses.
    kalibr : content of imu.yaml, "" without one.
    notes : one line for each part that could not be determined.
    """

    node: str
    identity: Sequence[tuple[str, str]]
    records: Sequence[SheetRecord]
    noise: Sequence[AllanResult] = ()
    warmups: Sequence[WarmupResult] = ()
    calibration: ImuCalibration | None = None
    kalibr: str = ""
    notes: Sequence[str] = ()

    def html(self) -> str:
        """Return the sheet as a page whose print-out has two sides."""
        units = "SI units" if unit_system() == "si" else "common units"
        lead = f"1σ throughout. Noise terms of IEEE 952 in {units}."
        sections = [
            Section("Sensor", tables=[PageTable(("", ""), self.identity)]),
            Section(
                "Records", " ".join(self.notes), [PageTable(RECORD_HEADINGS, [r.row() for r in self.records])]
            ),
            *self._noise_sections(),
            *self._warmup_sections(),
            *self._calibration_sections(),
            *self._plan_section(),
            *self._files_section(),
        ]
        return render_page(f"Test sheet of {self.node}", lead, sections, is_sheet=True)

    def _noise_sections(self) -> list[Section]:
        sections = []
        for title, wants_gyro in (("Noise of the gyro", True), ("Noise of the accelerometer", False)):
            named = [(it.channel, it) for it in self.noise if is_gyro(it.channel) == wants_gyro]
            if named:
                figure = render_drawing(functools.partial(allan_figure, named, ""))
                sections.append(Section(title, tables=[comparison_table(named)], figures=[figure]))
        return sections

    def _warmup_sections(self) -> list[Section]:
        return [
            Section(
                f"Warm-up of {it.channel}",
                summarise_warmup(it),
                []
                if it.accepted is None
                else [PageTable(warmup_headings(), warmup_rows(it.accepted, it.sigma))],
                starts_page=number == 0,
            )
            for number, it in enumerate(self.warmups)
        ]

    def _calibration_sections(self) -> list[Section]:
        it = self.calibration
        if it is None:
            return []
        text = imu_verdict(it)
        # The meanings are left out, because they would make each row two lines high.
        rows = [row[:-1] for row in parameter_rows(it)]
        table = PageTable(parameter_headings()[:-1], rows)
        return [Section("Calibration", text, [table], starts_page=not self.warmups)]

    def _plan_section(self) -> list[Section]:
        """Return the poses to set for a calibration, if the noise of the accelerometers alone is known."""
        accel = [it for it in self.noise if not is_gyro(it.channel)]
        if self.calibration is not None or not accel or any(it.terms["N"].value is None for it in accel):
            return []
        plan = plan_poses(noise_of_accelerometers(accel), PLANNED_BIAS_SIGMA, PLANNED_TURN_S)
        return [Section("Poses for a calibration", f"With this noise {plan.summary()}.")]

    def _files_section(self) -> list[Section]:
        lines = []
        if self.calibration is not None or any(it.accepted is not None for it in self.warmups):
            lines.append("calibration.toml: hubodo flash PORT --calibration, fuse and record --calibration.")
        if self.kalibr:
            lines.append("imu.yaml, for kalibr:")
        return [Section("Files", " ".join(lines), listing=self.kalibr)] if lines else []
