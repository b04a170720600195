"""Where the channels of a node clip: told by the vehicle file or by the node, or seen in its samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.node_screening import find_runs
from hubodo.recording import Table
from hubodo.vehicle import NodeMount

DEFAULT_RANGES = {"gyro": math.radians(2000.0), "accel": 16.0 * STANDARD_GRAVITY}
"""rad/s and m/s²; the ranges of the firmware, where nothing tells them."""

_MIN_RANGES = {"gyro": math.radians(120.0), "accel": 1.9 * STANDARD_GRAVITY}
"""rad/s and m/s²; below them no pile is looked for: no inertial sensor ends before 125 deg/s or 2 g."""

_CLIPPING_FRACTION, _CORRECTED_CLIPPING_FRACTION = 0.995, 0.97
"""Share of the range from which on a sample counts as clipped.

Half a percent for the steps of its words; three where the samples are corrected by a calibration, which moves
the limit by scale and bias. What is taken as clipped without need is only known less well.
"""

_RANGE_TOLERANCE_RATIO = 1.01
"""Share of a range that samples must reach to show that it is not where they end."""

_MIN_CLIPPED_SAMPLES, _MIN_CLIPPED_RUN, _MAX_REPEAT_FRACTION = 10, 4, 0.2
"""Samples at the very end of all, so many of them in a row, that make a pile, where of the other samples at
most this share repeats the one before: a channel without noise repeats itself anywhere. Estimated."""


@dataclass(frozen=True, slots=True)
class SensorRange:
    """value: rad/s or m/s²; source: in words."""

    value: float
    source: str


@dataclass(frozen=True, slots=True)
class NodeRanges:
    """Where a node's samples end. warnings: where what was told is not what the samples show."""

    gyro: SensorRange
    accel: SensorRange
    corrected: bool = False
    warnings: tuple[str, ...] = ()

    @property
    def clipping_limits(self) -> dict[str, float]:
        """From which on samples count as clipped, by the names of `WheelNode`."""
        share = _CORRECTED_CLIPPING_FRACTION if self.corrected else _CLIPPING_FRACTION
        return {"gyro_limit": share * self.gyro.value, "accel_limit": share * self.accel.value}

    def as_json(self) -> dict[str, Any]:
        """For fuse.json."""
        return {"gyro_range": asdict(self.gyro), "accel_range": asdict(self.accel)}


def determine_ranges(
    mount: NodeMount, metadata: Mapping[str, str], samples: Table | None = None, *, corrected: bool = False
) -> NodeRanges:
    """The vehicle file goes before what the node told of itself, and both before the usual ranges.

    told: the metadata `node.NAME` of a log, or what a node says when it begins. samples: as recorded; where
    they stand at another end, that is where they clip. corrected: whether a calibration is applied to them.
    """
    found, warnings = {}, []
    for kind, given, key, unit in (
        ("gyro", mount.gyro_range, "gyro_range_dps", math.radians(1.0)),
        ("accel", mount.accel_range, "accel_range_g", STANDARD_GRAVITY),
    ):
        declared = _declared_range(given, metadata.get(key, ""), unit) or SensorRange(
            DEFAULT_RANGES[kind], "the usual one"
        )
        if samples is not None and len(samples):
            values = samples.gyro if kind == "gyro" else samples.accel
            found[kind], said = _check_against_samples(kind, np.abs(values), declared)
            if said and (given or metadata.get(key)):
                warnings.append(said)
        else:
            found[kind] = declared
    return NodeRanges(found["gyro"], found["accel"], corrected, tuple(warnings))


def node_metadata(metadata: Mapping[str, str], name: str) -> dict[str, str]:
    """What a log's metadata holds of a node."""
    prefix = f"node.{name}."
    return {key.removeprefix(prefix): text for key, text in metadata.items() if key.startswith(prefix)}


def _declared_range(given: float | None, text: str, unit: float) -> SensorRange | None:
    if given is not None:
        return SensorRange(given, "vehicle file")
    try:
        value = float(text) * unit
    except ValueError:
        return None
    return SensorRange(value, "told by the node") if math.isfinite(value) and value > 0.0 else None


def _check_against_samples(kind: str, size: Array, declared: SensorRange) -> tuple[SensorRange, str]:
    """The range that samples (N, 3), without sign, show where they show one, and what to say then."""
    unit = "rad/s" if kind == "gyro" else "m/s²"
    largest = max(size[np.isfinite(size)].tolist(), default=0.0)
    end = _find_clipping_level(size, kind)
    told = f"{declared.value:.4g} {unit} ({declared.source})"
    if end is not None and not 1.0 / _RANGE_TOLERANCE_RATIO < end / declared.value < _RANGE_TOLERANCE_RATIO:
        said = f"{kind} samples stand at {end:.4g}, not at {told}: taken as clipped there"
        return SensorRange(end, "seen: samples stand at it"), said
    if end is None and largest > _RANGE_TOLERANCE_RATIO * declared.value:
        said = f"{kind} samples reach {largest:.4g}, beyond {told}: none is taken as clipped"
        return SensorRange(_RANGE_TOLERANCE_RATIO * largest, "seen: samples go up to it"), said
    return declared, ""


def _find_clipping_level(size: Array, kind: str) -> float | None:
    """Where samples of a channel stand at their end, None where none does.

    Words of two's complement end one step further on the negative side.
    """
    ends = []
    for channel in size.T:
        top = max(channel[np.isfinite(channel)].tolist(), default=0.0)
        if top < _MIN_RANGES[kind]:
            continue
        at_end = channel >= top * (1.0 - 1e-4)
        same = np.append(False, channel[1:] == channel[:-1])
        others = ~at_end & np.append(False, ~at_end[:-1])
        repeats = np.count_nonzero(same & others) / (1 + np.count_nonzero(others))
        longest = max((last - first + 1 for first, last in find_runs(at_end)), default=0)
        enough = np.count_nonzero(at_end) >= _MIN_CLIPPED_SAMPLES and longest >= _MIN_CLIPPED_RUN
        if enough and repeats < _MAX_REPEAT_FRACTION:
            ends.append(top)
    return min(ends) if ends else None
