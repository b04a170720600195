"""Clipping ranges of a node's gyro and accelerometer, from the vehicle file, the node, or its samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hubodo.arrays import Array, find_runs
from hubodo.earth import STANDARD_GRAVITY
from hubodo.recording import Table
from hubodo.vehicle import NodeMount

DEFAULT_RANGES = {"gyro": math.radians(2000.0), "accel": 16.0 * STANDARD_GRAVITY}
"""rad/s and m/s²; the ranges set by the firmware, used where no other source gives them."""

HIGH_G_NOISE_DENSITY, HIGH_G_CALIBRATION_SIGMA = 5e-3 * STANDARD_GRAVITY, 0.3
"""m/s²/√Hz and m/s², 1 sigma: white noise of an ADXL375 (data sheet), error of its calibration by the IMU,
see `range_extension.py`."""

_MIN_RANGES = {"gyro": math.radians(120.0), "accel": 1.9 * STANDARD_GRAVITY}
"""rad/s and m/s²; smaller ranges are not considered: inertial sensors have at least 125 deg/s and 2 g."""

_CLIPPING_FRACTION, _CORRECTED_CLIPPING_FRACTION = 0.995, 0.97
"""Fraction of the range from which on a sample counts as clipped.

Half a percent below for quantisation; three percent where a calibration has corrected the samples, which
moves the limit by scale and bias. A sample that is wrongly taken as clipped only increases a sigma.
"""

_RANGE_TOLERANCE_RATIO = 1.01
"""Samples beyond this multiple of a range show that they do not clip there."""

_MIN_CLIPPED_SAMPLES, _MIN_CLIPPED_RUN, _MAX_REPEAT_FRACTION = 10, 4, 0.2
"""Criteria for clipping in the samples of a channel. Estimated.

That many samples at the maximum, that many of them in a row, and at most that fraction of the other
samples equal to their predecessor: a channel without noise repeats itself at any value.
"""


@dataclass(frozen=True, slots=True)
class SensorRange:
    """A range in rad/s or m/s², and its source as text."""

    value: float
    source: str


@dataclass(frozen=True, slots=True)
class NodeRanges:
    """Ranges at which the samples of a node clip.

    Attributes
    ----------
    gyro, accel : the ranges with their source.
    corrected : whether a calibration has been applied to the samples.
    warnings : one line for each declared range that the samples contradict.
    """

    gyro: SensorRange
    accel: SensorRange
    corrected: bool = False
    warnings: tuple[str, ...] = ()

    @property
    def clipping_limits(self) -> dict[str, float]:
        """Return the values from which on samples count as clipped, by the names of `WheelNode`."""
        share = _CORRECTED_CLIPPING_FRACTION if self.corrected else _CLIPPING_FRACTION
        return {"gyro_limit": share * self.gyro.value, "accel_limit": share * self.accel.value}

    def as_json(self) -> dict[str, Any]:
        """Return the entry of fuse.json."""
        return {"gyro_range": asdict(self.gyro), "accel_range": asdict(self.accel)}


def determine_ranges(
    mount: NodeMount, metadata: Mapping[str, str], samples: Table | None = None, *, corrected: bool = False
) -> NodeRanges:
    """Return the ranges of a node: from the vehicle file, else as reported by the node, else the defaults.

    metadata: the metadata `node.NAME` of a log, or what a node reports when it starts. samples: as recorded;
    a value at which they clip takes precedence. corrected: whether they will be calibrated.
    """
    ranges, warnings = {}, []
    for kind, given, key, unit in (
        ("gyro", mount.gyro_range, "gyro_range_dps", math.radians(1.0)),
        ("accel", mount.accel_range, "accel_range_g", STANDARD_GRAVITY),
    ):
        declared = _declared_range(given, metadata.get(key, ""), unit) or SensorRange(
            DEFAULT_RANGES[kind], "default"
        )
        if samples is not None and len(samples):
            values = samples.gyro if kind == "gyro" else samples.accel
            ranges[kind], warning = _check_against_samples(kind, np.abs(values), declared)
            if warning and (given or metadata.get(key)):
                warnings.append(warning)
        else:
            ranges[kind] = declared
    return NodeRanges(ranges["gyro"], ranges["accel"], corrected, tuple(warnings))


def uncorrected_accel_limit(accel_range: float) -> float:
    """Return the value, m/s², from which on samples that no calibration has corrected count as saturated."""
    return _CLIPPING_FRACTION * accel_range


def node_metadata(metadata: Mapping[str, str], name: str) -> dict[str, str]:
    """Return the metadata of one node in the metadata of a log."""
    prefix = f"node.{name}."
    return {key.removeprefix(prefix): text for key, text in metadata.items() if key.startswith(prefix)}


def _declared_range(given: float | None, text: str, unit: float) -> SensorRange | None:
    """Return the range given in the vehicle file or as text by the node, None without either."""
    if given is not None:
        return SensorRange(given, "vehicle file")
    try:
        value = float(text) * unit
    except ValueError:
        return None
    return SensorRange(value, "node") if math.isfinite(value) and value > 0.0 else None


def _check_against_samples(kind: str, magnitudes: Array, declared: SensorRange) -> tuple[SensorRange, str]:
    """Return the range at which magnitudes (N, 3) of samples clip, else the declared one, and a warning."""
    unit = "rad/s" if kind == "gyro" else "m/s²"
    largest = _largest_finite(magnitudes)
    clipping_level = _find_clipping_level(magnitudes, kind)
    declared_text = f"{declared.value:.4g} {unit} ({declared.source})"
    if (
        clipping_level is not None
        and not 1.0 / _RANGE_TOLERANCE_RATIO < clipping_level / declared.value < _RANGE_TOLERANCE_RATIO
    ):
        warning = (
            f"{kind} samples clip at {clipping_level:.4g}, not at {declared_text}: taken as clipped there"
        )
        return SensorRange(clipping_level, "samples: they clip there"), warning
    if clipping_level is None and largest > _RANGE_TOLERANCE_RATIO * declared.value:
        warning = f"{kind} samples reach {largest:.4g}, beyond {declared_text}: none is taken as clipped"
        return SensorRange(_RANGE_TOLERANCE_RATIO * largest, "samples: they reach it"), warning
    return declared, ""


def _find_clipping_level(magnitudes: Array, kind: str) -> float | None:
    """Return the value at which samples of a channel clip, None where no channel clips.

    The negative limit of a two's complement word is one step larger, so values near the maximum count too.
    """
    clipping_levels = []
    for channel in magnitudes.T:
        maximum = _largest_finite(channel)
        if maximum < _MIN_RANGES[kind]:
            continue
        at_maximum = channel >= maximum * (1.0 - 1e-4)
        equals_previous = np.append(False, channel[1:] == channel[:-1])
        others = ~at_maximum & np.append(False, ~at_maximum[:-1])
        repeats = np.count_nonzero(equals_previous & others) / (1 + np.count_nonzero(others))
        longest_run = max((end - first for first, end in find_runs(at_maximum)), default=0)
        is_pile = np.count_nonzero(at_maximum) >= _MIN_CLIPPED_SAMPLES and longest_run >= _MIN_CLIPPED_RUN
        if is_pile and repeats < _MAX_REPEAT_FRACTION:
            clipping_levels.append(maximum)
    return min(clipping_levels) if clipping_levels else None


def _largest_finite(magnitudes: Array) -> float:
    """Return the largest finite magnitude; 0 if there is none."""
    return float(np.max(magnitudes, initial=0.0, where=np.isfinite(magnitudes)))
