"""Noise terms of a node as parameters of other programs: kalibr, and imu_filter_madgwick of ROS."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

from hubodo.errors import InputError
from hubodo.log.topics import imu_topic

if TYPE_CHECKING:
    from hubodo.sensors.allan.result import AllanResult

NOISE_CHANNELS = ("gx", "gy", "gz", "ax", "ay", "az")
"""Channels that the files need."""
_MADGWICK_FACTOR = math.sqrt(3.0 / 4.0)


def kalibr_yaml(results: Iterable[AllanResult]) -> str:
    """Return the imu.yaml of kalibr from the results of the six channels of a node.

    The model of kalibr has continuous white noise with samples of σ/√dt, which is N of IEEE 952, and a random
    walk of the bias, which is K. Each value is the root mean square over three axes. Where a record does not
    show a term, its 95 % limit is written and the comment says so.

    Raises InputError if a channel is missing or a record has no limit either.
    """
    by_channel = _by_channel(results)
    lines = [
        "# Noise terms (IEEE 952) by hubodo allan: N as noise density, K as random walk, rms of x, y, z."
    ]
    for title, letter, unit in (("gyroscope", "g", "rad/s"), ("accelerometer", "a", "m/s^2")):
        density, density_note = _rms_term(by_channel, letter, "N")
        walk, walk_note = _rms_term(by_channel, letter, "K")
        lines += [
            f"{title}_noise_density: {density:.6e}  # {unit}/sqrt(Hz){density_note}",
            f"{title}_random_walk: {walk:.6e}  # {unit}/s/sqrt(Hz){walk_note}",
        ]
    first = by_channel["gx"]
    lines += [f"rostopic: {imu_topic(first.node)}", f"update_rate: {1.0 / first.record.dt:.6g}  # Hz"]
    return "\n".join(lines) + "\n"


def imu_filter_yaml(results: Iterable[AllanResult]) -> str:
    """Return parameters of imu_filter_madgwick for any name of its node, from the six channels of a node.

    Equations 33 and 50 of Madgwick (2010), An efficient orientation filter: gain = √(3/4) times the error of
    the rate (here the noise of a sample, N/√dt), zeta = √(3/4) times its drift (here K after one second).

    Raises InputError if a channel is missing or a record has no limit either.
    """
    by_channel = _by_channel(results)
    noise, noise_note = _rms_term(by_channel, "g", "N")
    walk, walk_note = _rms_term(by_channel, "g", "K")
    gain = _MADGWICK_FACTOR * noise / math.sqrt(by_channel["gx"].record.dt)
    return (
        "# By hubodo allan, from the noise at standstill: accelerations of a vehicle need a smaller gain.\n"
        "/**:\n"
        "  ros__parameters:\n"
        f"    gain: {gain:.6e}  # rad/s, noise of a sample{noise_note}\n"
        f"    zeta: {_MADGWICK_FACTOR * walk:.6e}  # rad/s^2, random walk of the bias in 1 s{walk_note}\n"
    )


def _by_channel(results: Iterable[AllanResult]) -> dict[str, AllanResult]:
    by_channel = {result.channel: result for result in results}
    missing = [name for name in NOISE_CHANNELS if name not in by_channel]
    if missing:
        raise InputError(f"{', '.join(missing)}: no result; a file for other programs needs all six channels")
    return by_channel


def _rms_term(by_channel: dict[str, AllanResult], sensor: str, term: str) -> tuple[float, str]:
    """Return the root mean square of a term over three axes, and a note on axes that only have a limit."""
    values, limited = [], []
    for axis in "xyz":
        result = by_channel[sensor + axis]
        fitted = result.fit.terms[term]
        value = fitted.limit if fitted.value is None else fitted.value
        if value is None:
            raise InputError(f"{result.name}: {term}: {fitted.reason}; record for longer")
        if fitted.value is None:
            limited.append(axis)
        values.append(value)
    note = f", upper limit (95 %) of {', '.join(limited)}" if limited else ""
    return math.sqrt(sum(value**2 for value in values) / len(values)), note
