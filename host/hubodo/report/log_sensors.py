"""What a log says about each node's sensors: rests, Allan deviation, warm-up, calibration from poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.calibration.apply import find_starts
from hubodo.errors import CalibrationError, InputError
from hubodo.recording import Event, Table
from hubodo.report.allan import allan_lead, allan_sections, duration_words, value_words
from hubodo.report.imu import held_out_words, imu_sections
from hubodo.report.page import Grid, Section
from hubodo.report.warmup import warmup_lead, warmup_sections
from hubodo.sensors.allan.characterise import characterise_noise
from hubodo.sensors.allan.ieee952 import term_units
from hubodo.sensors.imu.calibrate import calibrate_imu
from hubodo.sensors.imu.standstills import find_standstills
from hubodo.sensors.standstill_checks import (
    TemperatureStep,
    check_units,
    find_temperature_step,
    first_disturbance,
)
from hubodo.sensors.warmup.characterise import characterise_warmup

Mask = NDArray[np.bool_]

CHANNELS = ("gx", "gy", "gz", "ax", "ay", "az")
_SHOWN_TERMS = ("N", "B", "K")
_TURNS = 0.35
"""rad/s: more than the zero-rate level of any part."""


@dataclass(frozen=True)
class SensorReport:
    """Sections of one node.

    missing: what its record cannot show, with the reason, one line each. facts: the findings, one line each.
    """

    sections: tuple[Section, ...]
    missing: tuple[str, ...]
    facts: tuple[str, ...]


def sensor_report(
    name: str, table: Table, events: tuple[Event, ...], t_zero_ns: int, gravity: float
) -> SensorReport:
    """Everything that a node's record shows about its sensors. gravity: m/s² at the place."""
    sections: list[Section] = []
    missing: list[str] = []
    facts: list[str] = []
    # What a log without an accelerometer has measured is examined, and the rest is named as missing.
    measured = tuple(channel for channel in CHANNELS if np.isfinite(table[channel]).any())
    absent = [channel for channel in CHANNELS if channel not in measured]
    if not measured:
        return SensorReport((), (f"{name}: the log holds no samples of it",), ())
    if absent:
        missing.append(f"{name}: {', '.join(absent)}: the log holds no samples")
    samples = np.column_stack([table[channel] for channel in measured])
    finite: Mask = np.asarray(np.isfinite(samples).all(axis=1))
    t, gyro, accel = table.t[finite], table.gyro[finite], table.accel[finite]
    span, words = _still_part(t, gyro, accel)
    if span is None:
        missing.append(f"{name}: noise terms and warm-up: {words}")
    else:
        facts.append(f"{name}: {words}")
        still = np.column_stack([gyro, accel])[span]
        temperature = _temperature(table, finite, span)
        try:
            check_units(still[:, :3], still[:, 3:])
        except InputError as error:
            missing.append(f"{name}: noise terms and warm-up: {error}")
        else:
            step = None if temperature is None else find_temperature_step(t[span], temperature)
            sections += _allan(name, measured, t[span], still, step, missing, facts)
            age = _age(events, name, float(t[span][0]), t_zero_ns)
            sections += _warmup(name, measured, t[span], still, temperature, step, age, missing, facts)
    if absent:
        missing.append(f"{name}: scale and cross-axis of the triads: all six channels are needed")
    else:
        sections += _poses(name, t, gyro, accel, gravity, missing, facts)
    if "temperature" not in table:
        missing.append(f"{name}: temperature: none in the log")
    return SensorReport(tuple(sections), tuple(missing), tuple(facts))


def _still_part(t: Array, gyro: Array, accel: Array) -> tuple[slice | None, str]:
    """The longest rest: all of it where nothing moved."""
    if len(t) < 2:
        return None, "no two samples have all channels that are measured"
    samples = np.column_stack([gyro, accel])
    samples = samples[:, np.isfinite(samples).all(axis=0)]
    if first_disturbance(t, samples) is None and not np.any(np.abs(np.median(gyro, axis=0)) > _TURNS):
        try:
            check_units(gyro, accel)
        except InputError as error:
            return None, str(error)
        return slice(0, len(t)), f"at rest all the time, {duration_words(float(t[-1] - t[0]))}"
    if samples.shape[1] < len(CHANNELS):
        return None, "the node moved, and rests within a movement are found with all six channels only"
    try:
        rests = find_standstills(t, gyro, accel)
    except CalibrationError as error:
        return None, str(error)
    # A wheel that turns evenly is as quiet as one that stands.
    rests = rests.select(np.abs(rests.gyro).max(axis=1) < _TURNS)
    if not len(rests):
        return None, "the node is nowhere at rest for a second"
    longest = int(np.argmax(rests.duration))
    words = (
        f"rests: {len(rests)}; the longest, {rests.duration[longest]:.1f} s from "
        f"{rests.t[longest, 0]:.1f} s on, is what the noise is judged by"
    )
    return slice(int(rests.start[longest]), int(rests.end[longest])), words


def _allan(
    name: str,
    measured: tuple[str, ...],
    t: Array,
    still: Array,
    step: TemperatureStep | None,
    missing: list[str],
    facts: list[str],
) -> list[Section]:
    rows: list[tuple[str, ...]] = []
    detail: list[Section] = []
    for k, channel in enumerate(CHANNELS):
        if channel not in measured:
            continue
        try:
            report = characterise_noise(t, still[:, k].copy(), channel, temperature_step=step)
        except InputError as error:
            missing.append(f"{name} {channel}: Allan deviation: {error}")
            continue
        shown = []
        for term in _SHOWN_TERMS:
            found, unit = report.fit.terms[term], term_units(channel)[term]
            if found.value is None or found.sigma is None:
                limit = "" if found.limit is None else f", below {value_words(found.limit, unit.si)}"
                shown.append(f"not shown{limit}")
            else:
                customary = value_words(found.value * unit.factor, unit.common)
                shown.append(f"{found.value:.3g} ± {found.sigma:.1g} {unit.si} ({customary})")
        rows.append((channel, *shown))
        if channel == "gz":
            facts.append(f"{name} gz: {allan_lead(report)}")
            detail = [
                replace(section, title=f"{name} gz: {section.title}") for section in allan_sections(report)
            ]
    if not rows:
        return []
    heading = ("channel", "white noise N", "bias instability B", "rate random walk K")
    text = "From the part at rest named above; hubodo allan gives each channel in full."
    return [Section(f"{name}: noise", text, [Grid(heading, rows)]), *detail]


def _warmup(
    name: str,
    measured: tuple[str, ...],
    t: Array,
    still: Array,
    temperature: Array | None,
    step: TemperatureStep | None,
    age: float | None,
    missing: list[str],
    facts: list[str],
) -> list[Section]:
    rows, detail = [], []
    for k, channel in enumerate(CHANNELS[:3]):
        if channel not in measured:
            continue
        try:
            report = characterise_warmup(
                t, still[:, k].copy(), channel, temperature=temperature, age=age or 0.0, temperature_step=step
            )
        except InputError as error:
            missing.append(f"{name} {channel}: warm-up: {error}")
            continue
        if report.accepted is None:
            missing.append(f"{name} {channel}: warm-up: {report.reason}")
        else:
            facts.append(f"{name} {channel}: {warmup_lead(report)}")
            detail += [
                replace(section, title=f"{name} {channel}: {section.title}")
                for section in warmup_sections(report, name)
            ]
        rows.append((channel, warmup_lead(report)))
    if not rows:
        return []
    text = (
        "The log does not say when the node was switched on: counted from its first sample at rest."
        if age is None
        else f"The node had been on for {duration_words(age)} when this rest began."
    )
    return [Section(f"{name}: warm-up", text, [Grid(("axis", "finding"), rows)]), *detail]


def _poses(
    name: str,
    t: Array,
    gyro: Array,
    accel: Array,
    gravity: float,
    missing: list[str],
    facts: list[str],
) -> list[Section]:
    try:
        result = calibrate_imu(t, gyro, accel, gravity=gravity)
    except (CalibrationError, InputError) as error:
        missing.append(f"{name}: scale and cross-axis of the triads: {error}")
        return []
    facts.append(
        f"{name}: {len(result.standstills)} rests in different poses calibrate it; length of gravity "
        f"{held_out_words(result.accel_held_out, 'm/s²')}"
    )
    return [
        Section(f"{name}: {section.title}", section.text, section.tables, section.figures)
        for section in imu_sections(result)
    ]


def _temperature(table: Table, finite: Mask, span: slice) -> Array | None:
    if "temperature" not in table:
        return None
    values = table["temperature"][finite][span]
    known = np.isfinite(values)
    if not known.any():
        return None
    rows = np.arange(len(values))
    return np.asarray(np.interp(rows, rows[known], values[known]))


def _age(events: tuple[Event, ...], name: str, t: float, t_zero_ns: int) -> float | None:
    """s since power-on at t, None where the log does not tell."""
    starts = [since for begun, since in find_starts(events, name) if (begun - t_zero_ns) * 1e-9 <= t + 1.0]
    return max(t - (starts[-1] - t_zero_ns) * 1e-9, 0.0) if starts else None
