"""Residuals in words: which channels an effect changed and when, and how look-alikes are told apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.problem.problem import CHANNELS, NodeData
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.tell.regimes import Regimes, course, when

# Channels that are named: the three that show most, none that shows less than so much of the first.
_NAMED, _FAINT = 3, 0.25
_ANY = "vary speed, turns and temperature more, for longer"
_DRIVE_BOTH_WAYS = "drive the same road in both directions"
_COUNT = "drive long and fast: gravity turning in ax and ay counts revolutions"
_SPLITS: Mapping[frozenset[str], str] = {
    frozenset(names.split()): words
    for names, words in {
        "wheel_radius gyro_scale_factor": _COUNT,
        "wheel_radius tyre_growth": "drive slowly and fast for as long each",
        "wheel_radius clock_skew": "change speed now and then: a skew is late at every change",
        "track_width wheel_camber": "turn both ways at speed: camber shows in az, gx and gy",
        "track_width wheel_radius": "drive straight for as long as in turns",
        "track_width gyro_scale_factor": "turn both ways: a scale error shows in straights too",
        "wheel_camber accel_bias": "turn both ways at speed: camber shows in gz, a bias does not",
        "gyro_g_sensitivity wheel_eccentricity": (
            "drive at two speeds: eccentricity grows with spin and shows in the accelerometer"
        ),
        "gyro_g_sensitivity gyro_bias": "turn at speed: the force across the wheel changes, a bias does not",
        "gyro_warmup gyro_temperature": "record from power-on with the temperature going up and down",
        "gyro_warmup gyro_bias": "record from power-on, several times as long as the warm-up takes",
        "gyro_temperature gyro_bias": "let the temperature change by some degrees",
        "gyro_rate_random_walk gyro_warmup": (
            "record longer, and again from a cold start: a walk does not repeat itself"
        ),
        "gyro_rate_random_walk gyro_bias": "record longer: a walk leaves where it was",
        "gyro_rate_random_walk gyro_temperature": "let the temperature go up and come back",
        "gyro_scale_factor tyre_growth": "drive slowly and fast for as long each",
        "gyro_scale_factor gyro_cubic": "drive slowly and fast for as long each",
        "gyro_scale_factor clock_skew": "change speed briskly: a skew is late at every change",
        "tyre_growth gyro_cubic": _COUNT,
        "road_grade gyro_nonorthogonality": _DRIVE_BOTH_WAYS,
        "road_grade accel_nonorthogonality": _DRIVE_BOTH_WAYS,
        "road_grade accel_bias": _DRIVE_BOTH_WAYS,
        "road_grade node_misalignment": _DRIVE_BOTH_WAYS,
        "gyro_lag time_offset": "change speed briskly: the accelerometer is late only with the clock",
        "gyro_lag wheel_slip": "change speed briskly, and turn: only a lag shows across the axle",
        "wheel_slip time_offset": "accelerate at different speeds, and turn while at it",
        "clock_skew time_offset": "record longer: a skew grows with time",
        "node_misalignment gyro_nonorthogonality": (
            "drive fast with brisk changes: a turned node turns its accelerometer too"
        ),
        "node_misalignment accel_nonorthogonality": "drive fast: a turned node leaks spin into gx and gy",
        "node_misalignment wheel_camber": "turn both ways at speed: camber shows in gz",
        "lever_arm accel_bias": "drive at two speeds: a lever arm grows with the square of the spin",
        "lever_arm accel_scale_factor": "drive at two speeds: a lever arm grows with the square of the spin",
        "accel_scale_factor accel_nonorthogonality": "accelerate and turn hard, both ways",
        "outliers sample_repeat": "look for samples that are equal to the one before: only repeats have them",
    }.items()
}


def manoeuvre(name: str, alike: Sequence[str]) -> str:
    """What would tell an effect from those that this log cannot tell it from."""
    ways = ((other, _SPLITS.get(frozenset({name, other}), _ANY)) for other in alike)
    return "; ".join(f"to tell it from {other}, {way}" for other, way in ways)


def where_words(before: Mapping[str, Residual], after: Mapping[str, Residual]) -> str:
    """The channels that asked for the change of the model, when and with what it goes; the strongest first.

    A channel's significance is that of its residual before along the change: (r · c) / |c| in declared sigma.
    """
    rows = []
    for name, residual in before.items():
        change = (after[name].predicted - residual.predicted) / residual.declared
        for row in np.flatnonzero(residual.node.used):
            size = float(np.linalg.norm(change[row]))
            if size > 0.0:
                sigmas = float(residual.value[row] / residual.declared[row] @ change[row]) / size
                rows.append((sigmas, name, int(row), change[row]))
    rows.sort(key=lambda it: -it[0])
    if not rows or rows[0][0] < 2.0:
        return "in no channel by itself"
    tables: dict[str, Regimes] = {}
    parts = []
    for sigmas, name, channel, series in rows[:_NAMED]:
        if sigmas < max(_FAINT * rows[0][0], 2.0):
            break
        node = before[name].node
        if name not in tables:
            tables[name] = Regimes(course(node))
        parts.append(f"{name}.{CHANNELS[channel]}, {_told(tables[name], node, series)}, {sigmas:.0f} σ")
    return "; ".join(parts)


def _told(regimes: Regimes, node: NodeData, series: Array) -> str:
    words = regimes.of(series).words
    stretch = "" if " from " in f" {words}" else when(node.t, series)
    return f"{words}, {stretch}" if stretch else words
