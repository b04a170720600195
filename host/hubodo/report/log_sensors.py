"""Sensor sections of a log's page: standstills, Allan deviation, warm-up and calibration from poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.calibration.apply import find_starts
from hubodo.errors import CalibrationError, InputError
from hubodo.pages.page import PageTable, Section
from hubodo.recording import Event, Table
from hubodo.sensors.allan.characterise import characterise_noise
from hubodo.sensors.allan.ieee952 import term_units
from hubodo.sensors.allan.page import allan_sections, format_duration, format_value, summarise_allan
from hubodo.sensors.imu.calibrate import calibrate_imu
from hubodo.sensors.imu.page import format_gravity_error, imu_sections
from hubodo.sensors.imu.standstills import find_standstills
from hubodo.sensors.standstill_channel import interpolate_temperature
from hubodo.sensors.standstill_checks import (
    TemperatureStep,
    check_units,
    find_temperature_step,
    first_disturbance,
)
from hubodo.sensors.warmup.characterise import characterise_warmup
from hubodo.sensors.warmup.page import summarise_warmup, warmup_sections

Mask = NDArray[np.bool_]

CHANNELS = ("gx", "gy", "gz", "ax", "ay", "az")
_SHOWN_TERMS = ("N", "B", "K")
_MIN_PLOTTED_STANDSTILL = 60.0  # s
_MAX_STATIONARY_RATE = 0.35
"""rad/s; exceeds the zero-rate offset of any MEMS gyro."""


@dataclass(frozen=True)
class SensorReport:
    """The sensor sections of one node.

    Attributes:
        sections: sections of the page.
        missing: results that the record does not allow, with the reasons, one line each.
        facts: findings, one line each.
    """

    sections: tuple[Section, ...]
    missing: tuple[str, ...]
    facts: tuple[str, ...]


def report_sensors(
    name: str, table: Table, events: tuple[Event, ...], t_zero_ns: int, gravity: float
) -> SensorReport:
    """Return all that a node's record shows about its sensors; gravity: local gravity, m/s²."""
    sections: list[Section] = []
    missing: list[str] = []
    facts: list[str] = []
    # Channels that were measured are evaluated; the others are listed as missing.
    measured = tuple(channel for channel in CHANNELS if np.isfinite(table[channel]).any())
    absent = [channel for channel in CHANNELS if channel not in measured]
    if not measured:
        return SensorReport((), (f"{name}: the log contains no samples",), ())
    if absent:
        missing.append(f"{name}: {', '.join(absent)}: the log contains no samples")
    samples = np.column_stack([table[channel] for channel in measured])
    finite: Mask = np.asarray(np.isfinite(samples).all(axis=1))
    t, gyro, accel = table.t[finite], table.gyro[finite], table.accel[finite]
    span, remark = _select_standstill(t, gyro, accel)
    if span is None:
        missing.append(f"{name}: noise terms and warm-up: {remark}")
    else:
        facts.append(f"{name}: {remark}")
        stationary = np.column_stack([gyro, accel])[span]
        temperature = interpolate_temperature(table, np.flatnonzero(finite)[span])
        try:
            check_units(stationary[:, :3], stationary[:, 3:])
        except InputError as error:
            missing.append(f"{name}: noise terms and warm-up: {error}")
        else:
            temperature_step = None if temperature is None else find_temperature_step(t[span], temperature)
            sections += _allan(name, measured, t[span], stationary, temperature_step, missing, facts)
            age = _age(events, name, float(t[span][0]), t_zero_ns)
            sections += _warmup(
                name, measured, t[span], stationary, temperature, temperature_step, age, missing, facts
            )
    if absent:
        missing.append(f"{name}: scale and cross-axis of the triads: all six channels are needed")
    else:
        sections += _poses(name, t, gyro, accel, gravity, missing, facts)
    if "temperature" not in table:
        missing.append(f"{name}: temperature: none in the log")
    return SensorReport(tuple(sections), tuple(missing), tuple(facts))


def _select_standstill(t: Array, gyro: Array, accel: Array) -> tuple[slice | None, str]:
    """Return the longest standstill (the whole record if nothing moved) or None, and a remark."""
    if len(t) < 2:
        return None, "fewer than two samples have all measured channels"
    samples = np.column_stack([gyro, accel])
    samples = samples[:, np.isfinite(samples).all(axis=0)]
    if first_disturbance(t, samples) is None and not np.any(
        np.abs(np.median(gyro, axis=0)) > _MAX_STATIONARY_RATE
    ):
        try:
            check_units(gyro, accel)
        except InputError as error:
            return None, str(error)
        return slice(0, len(t)), f"stationary during the whole record, {format_duration(float(t[-1] - t[0]))}"
    if samples.shape[1] < len(CHANNELS):
        return None, "the node moved, and standstills can only be detected with all six channels"
    try:
        standstills = find_standstills(t, gyro, accel)
    except CalibrationError as error:
        return None, str(error)
    # A wheel that turns at a constant rate is as quiet as a stationary one.
    standstills = standstills.select(np.abs(standstills.gyro).max(axis=1) < _MAX_STATIONARY_RATE)
    if not len(standstills):
        return None, "the node is never stationary for a second"
    longest = int(np.argmax(standstills.duration))
    remark = (
        f"standstills: {len(standstills)}; the noise is evaluated in the longest, "
        f"{standstills.duration[longest]:.1f} s from {standstills.t[longest, 0]:.1f} s on"
    )
    return slice(int(standstills.start[longest]), int(standstills.end[longest])), remark


def _allan(
    name: str,
    measured: tuple[str, ...],
    t: Array,
    stationary: Array,
    temperature_step: TemperatureStep | None,
    missing: list[str],
    facts: list[str],
) -> list[Section]:
    rows: list[tuple[str, ...]] = []
    detail: list[Section] = []
    reasons: dict[str, list[str]] = {}
    for k, channel in enumerate(CHANNELS):
        if channel not in measured:
            continue
        try:
            result = characterise_noise(
                t, stationary[:, k].copy(), channel, temperature_step=temperature_step
            )
        except InputError as error:
            reasons.setdefault(f"Allan deviation: {error}", []).append(channel)
            continue
        shown = []
        for term in _SHOWN_TERMS:
            noise_term, unit = result.fit.terms[term], term_units(channel)[term]
            if noise_term.value is None or noise_term.sigma is None:
                limit = (
                    "" if noise_term.limit is None else f", below {format_value(noise_term.limit, unit.si)}"
                )
                shown.append(f"not shown{limit}")
            else:
                common = format_value(noise_term.value * unit.factor, unit.common)
                shown.append(f"{noise_term.value:.3g} ± {noise_term.sigma:.1g} {unit.si} ({common})")
        rows.append((channel, *shown))
        if channel == "gz":
            facts.append(f"{name} gz: {summarise_allan(result)}")
            if t[-1] - t[0] < _MIN_PLOTTED_STANDSTILL:
                continue  # a deviation from a few seconds is mostly uncertainty
            detail = [
                replace(section, title=f"{name} gz: {section.title}") for section in allan_sections(result)
            ]
    missing += _missing_of_channels(name, reasons)
    if not rows:
        return []
    heading = ("channel", "white noise N", "bias instability B", "rate random walk K")
    text = "From the standstill given above; hubodo allan shows each channel in full."
    return [Section(f"{name}: noise", text, [PageTable(heading, rows)]), *detail]


def _warmup(
    name: str,
    measured: tuple[str, ...],
    t: Array,
    stationary: Array,
    temperature: Array | None,
    temperature_step: TemperatureStep | None,
    age: float | None,
    missing: list[str],
    facts: list[str],
) -> list[Section]:
    rows, detail = [], []
    reasons: dict[str, list[str]] = {}
    for k, channel in enumerate(CHANNELS[:3]):
        if channel not in measured:
            continue
        try:
            result = characterise_warmup(
                t,
                stationary[:, k].copy(),
                channel,
                temperature=temperature,
                age=age or 0.0,
                temperature_step=temperature_step,
                node=name,
            )
        except InputError as error:
            reasons.setdefault(f"warm-up: {error}", []).append(channel)
            continue
        if result.accepted is None:
            reasons.setdefault(f"warm-up: {result.reason}", []).append(channel)
        else:
            facts.append(f"{name} {channel}: {summarise_warmup(result)}")
            detail += [
                replace(section, title=f"{name} {channel}: {section.title}")
                for section in warmup_sections(result)
            ]
        rows.append((channel, summarise_warmup(result)))
    missing += _missing_of_channels(name, reasons)
    if not rows:
        return []
    text = (
        "The log does not contain the time of power-on: times are from the first stationary sample."
        if age is None
        else f"The node had been on for {format_duration(age)} at the start of this standstill."
    )
    return [Section(f"{name}: warm-up", text, [PageTable(("axis", "finding"), rows)]), *detail]


def _missing_of_channels(name: str, reasons: dict[str, list[str]]) -> list[str]:
    """Return a line for each reason why results of channels are missing; reasons: reason to channels."""
    return [f"{name} {', '.join(channels)}: {reason}" for reason, channels in reasons.items()]


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
    count = len(result.standstills or ())
    held_out = result.accel_held_out
    check = "none held out" if held_out is None else f"norm of gravity {format_gravity_error(held_out)}"
    facts.append(f"{name}: calibrated from {count} standstills in different poses; {check}")
    return [
        Section(f"{name}: {section.title}", section.text, section.tables, section.figures)
        for section in imu_sections(result)
    ]


def _age(events: tuple[Event, ...], name: str, t: float, t_zero_ns: int) -> float | None:
    """Return the time since power-on at t, s, or None if the log does not contain it."""
    starts = [since for begun, since in find_starts(events, name) if (begun - t_zero_ns) * 1e-9 <= t + 1.0]
    return max(t - (starts[-1] - t_zero_ns) * 1e-9, 0.0) if starts else None
