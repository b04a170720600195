"""A calibration applied on read: raw samples to true ones and back, by one formula.

The sensor chain (the model's README, host/hubodo/model/README.md) is undone from its end. With b the
biases, e the scale errors, N the non-orthogonalities of a triad (`triad.py`), m the rotation vector of
`node_misalignment`, S the answer of the gyros to specific force (row = gyro axis), and age the time since
power-on:

    f_m   = (I + diag(e_a) + N_a)^-1 (a_raw - b_a)
    u     = g_raw - b_g - C1 (1 - e^(-age / T)) - k (temperature - 25 degC) - S f_m
    w_m   : (I + diag(e_g) + N_g) w_m + (0, 0, c w_mz^3) = u
    omega = R(m) w_m,    f = R(m) f_m,    R(m) = exp([m]x)

A mounting turned by m makes a vector v read R(m)^T v, so R(m) turns it back. A channel at its limit stays
there: what is clipped must be seen to be clipped.

What a calibration does not hold counts as zero; `lever_arm`, `wheel_radius` and `track_width` are no errors
of the sensor and go on to the odometry. Every step works sample by sample without sums over samples, so a
live run in portions and a log in one piece give the same bits. The raw log is never rewritten.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.calibration.file import XYZ, CalibratedEffect, Calibration, NodeCalibration, Quantity, node_serial
from hubodo.calibration.triad import Triad, triad_from_effects
from hubodo.effects.warmup_models import REFERENCE_CELSIUS
from hubodo.errors import CalibrationError
from hubodo.recording import Event, Table

Array = NDArray[np.float64]

APPLIED = (
    "gyro_bias",
    "gyro_warmup",
    "gyro_temperature",
    "gyro_g_sensitivity",
    "gyro_scale_factor",
    "gyro_nonorthogonality",
    "gyro_cubic",
    "accel_bias",
    "accel_scale_factor",
    "accel_nonorthogonality",
    "node_misalignment",
)
"""Effects that the formula undoes."""

GYRO_LIMIT, ACCEL_LIMIT = 34.8, 156.0
"""rad/s, m/s²: from here on a channel of the widest range (2000 deg/s, 16 g) is taken to be clipped."""

_FASTEST = 36.0
_CUBIC_STEPS = 6
_S_NAMES = (("xx", "xy", "xz"), ("yx", "yy", "yz"), XYZ)


@dataclass(frozen=True)
class SampleCorrection:
    """What is undone in the samples of one node; `from_calibration` makes it.

    warmup: (3,) rad/s, time_constant: s. temperature: (3,) rad/s per degree C. g_sensitivity: (3, 3)
    (rad/s)/(m/s²), row = gyro. cubic: 1/(rad/s)². mounting: (3, 3) R(m).
    """

    gyro: Triad = field(default_factory=Triad)
    accel: Triad = field(default_factory=Triad)
    warmup: Array = field(default_factory=lambda: np.zeros(3))
    time_constant: float = math.inf
    temperature: Array = field(default_factory=lambda: np.zeros(3))
    g_sensitivity: Array = field(default_factory=lambda: np.zeros((3, 3)))
    cubic: float = 0.0
    mounting: Array = field(default_factory=lambda: np.eye(3))

    @staticmethod
    def from_calibration(node: NodeCalibration) -> SampleCorrection:
        """The correction of a node. Raises CalibrationError for numbers that no sensor has."""
        effects, none = node.effects, CalibratedEffect({})
        gyro, accel = triad_from_effects(effects, "gyro"), triad_from_effects(effects, "accel")
        for kind, triad in (("gyro", gyro), ("accel", accel)):
            if not 0.5 < abs(float(np.linalg.det(triad.matrix))) < 2.0:
                raise CalibrationError(
                    f"the calibration's {kind}_scale_factor and {kind}_nonorthogonality leave no triad; "
                    "calibrate this node anew"
                )
        warmup = effects.get("gyro_warmup", none)
        if warmup.parameters and not warmup.value("time_constant") > 0:
            raise CalibrationError("the calibration's gyro_warmup has no time_constant above 0 s; add it")
        sensitivity = effects.get("gyro_g_sensitivity", none)
        cubic = effects.get("gyro_cubic", none).value("z")
        if abs(3.0 * cubic * _FASTEST**2) > 0.5:
            raise CalibrationError(
                f"the calibration's gyro_cubic z = {cubic:g} would turn the scale around within the range "
                "of the gyro; calibrate this node anew"
            )
        return SampleCorrection(
            gyro,
            accel,
            _xyz(warmup),
            warmup.value("time_constant") if warmup.parameters else math.inf,
            _xyz(effects.get("gyro_temperature", none)),
            np.array([[sensitivity.value(name) for name in row] for row in _S_NAMES]),
            cubic,
            _rotation(_xyz(effects.get("node_misalignment", none))),
        )

    @property
    def needs_temperature(self) -> bool:
        """Whether the bias follows the thermometer."""
        return bool(self.temperature.any())

    def apply(
        self,
        gyro: Array,
        accel: Array,
        *,
        age: Array | None = None,
        temperature: Array | float | None = None,
    ) -> tuple[Array, Array]:
        """True (gyro, accel) from raw ones, (N, 3) rad/s and m/s².

        age: (N,) s since power-on, for the warm-up, which is left out without. temperature: (N,) or one,
        degrees C; its term is left out without.
        """
        force = _times(_inverse(self.accel), accel - self.accel.bias)
        rest = gyro - self.gyro.bias - self._drift(len(gyro), age, temperature)
        rest = rest - _times(self.g_sensitivity, force)
        inverse = _inverse(self.gyro)
        rate = _times(inverse, rest)
        if self.cubic:
            spin = _cubic_root(rate[:, 2], inverse[2, 2] * self.cubic)
            rate = rate - np.outer(self.cubic * (spin * spin * spin), inverse[:, 2])
        rate, force = _times(self.mounting, rate), _times(self.mounting, force)
        return _clipped(gyro, rate, GYRO_LIMIT), _clipped(accel, force, ACCEL_LIMIT)

    def unapply(
        self,
        gyro: Array,
        accel: Array,
        *,
        age: Array | None = None,
        temperature: Array | float | None = None,
    ) -> tuple[Array, Array]:
        """What the node shows for true (gyro, accel): the reverse of `apply`, below the limits."""
        back = self.mounting.T
        rate, force = _times(back, gyro), _times(back, accel)
        raw = _times(self.gyro.matrix, rate) + self.gyro.bias
        raw[:, 2] += self.cubic * rate[:, 2] ** 3
        raw = raw + self._drift(len(gyro), age, temperature) + _times(self.g_sensitivity, force)
        return raw, _times(self.accel.matrix, force) + self.accel.bias

    def _drift(self, count: int, age: Array | None, temperature: Array | float | None) -> Array:
        """(N, 3) of warm-up and temperature, rad/s."""
        made = np.zeros((count, 3))
        if age is not None and self.warmup.any():
            # One by one: a vectorised exponential may round by the place in the array.
            grown = [-math.expm1(-max(a, 0.0) / self.time_constant) for a in np.asarray(age).tolist()]
            made += np.array(grown)[:, None] * self.warmup
        if temperature is not None and self.needs_temperature:
            warm = np.broadcast_to(np.asarray(temperature, np.float64), (count,)) - REFERENCE_CELSIUS
            made += warm[:, None] * self.temperature
        return made


@dataclass(frozen=True)
class Applied:
    """A recording's nodes with a calibration applied.

    nodes: by name. left: the calibration for the odometry: what was applied has the value 0 and keeps its
    sigma, all else is as in the file. used: by node serial, effects applied, power-on (s on the log's clock,
    None when it is not known). warnings: one line each.
    """

    nodes: Mapping[str, Table]
    left: Calibration
    used: Mapping[str, Mapping[str, Any]]
    warnings: tuple[str, ...]


def apply_calibration(
    nodes: Mapping[str, Table],
    calibration: Calibration,
    *,
    metadata: Mapping[str, str] | None = None,
    events: Iterable[Event] = (),
    t_zero_ns: int = 0,
) -> Applied:
    """Apply a calibration to the nodes of a recording; nodes that it does not know stay as they are.

    metadata, events, t_zero_ns: of the recording; they tell serials and when the nodes were switched on;
    where they do not, power-on is taken to be a node's first sample. Raises CalibrationError when the
    calibration was made for a node with another serial.
    """
    made, used, warnings = dict(nodes), {}, []
    known = tuple(events)
    for name, node in calibration.nodes.items():
        if name not in nodes:
            continue
        check_serial(name, node, node_serial(metadata or {}, name))
        correction = SampleCorrection.from_calibration(node)
        table = nodes[name]
        starts = power_on_times(known, name)
        age = age_of(table.t, starts, t_zero_ns)
        temperature = _temperature(table)
        if correction.needs_temperature and temperature is None:
            warnings.append(
                f"{name}: the log has no temperature, so gyro_temperature of the calibration is not applied"
            )
        if correction.warmup.any() and not starts:
            warnings.append(
                f"{name}: the log does not say when the node was switched on; its warm-up is counted from "
                "its first sample"
            )
        gyro, accel = correction.apply(table.gyro, table.accel, age=age, temperature=temperature)
        columns = dict(table.columns)
        columns |= dict(zip(("gx", "gy", "gz"), gyro.T, strict=True))
        columns |= dict(zip(("ax", "ay", "az"), accel.T, strict=True))
        made[name] = Table(columns, table.t_ns)
        used[name] = {
            "serial": node.serial,
            "applied": [effect for effect in APPLIED if effect in node.effects],
            "power_on": (starts[0][1] - t_zero_ns) * 1e-9 if starts else None,
        }
    return Applied(made, left_over(calibration), used, tuple(warnings))


def left_over(calibration: Calibration) -> Calibration:
    """The calibration as it holds for samples that it has been applied to.

    The errors that were taken out are zero, as surely as they were known; the others stand as they were.
    """
    nodes = {
        name: replace(
            node,
            effects={
                effect: _zeroed(what) if effect in APPLIED else what for effect, what in node.effects.items()
            },
        )
        for name, node in calibration.nodes.items()
    }
    return replace(calibration, nodes=nodes)


def check_serial(name: str, node: NodeCalibration, serial: str) -> None:
    """Raises CalibrationError when a calibration is of another node than the one with this serial.

    Where one of the two is not known, nothing can be checked.
    """
    if node.serial and serial and node.serial.lower() != serial.lower():
        raise CalibrationError(
            f"the calibration of {name!r} is for the node with serial {node.serial}, the log has {serial} "
            "there; give that node's own calibration, or calibrate this one"
        )


def power_on_times(events: Iterable[Event], node: str) -> list[tuple[int, int]]:
    """(first sample, power-on), ns, of each start of a node that a log knows of, oldest first."""
    return sorted(
        (event.t_ns, int(event.data["power_on_ns"]))
        for event in events
        if event.kind == "started" and event.source == node and "power_on_ns" in event.data
    )


def age_of(t: Array, starts: list[tuple[int, int]], t_zero_ns: int) -> Array:
    """(N,) s since power-on at t (N,) s; since the first sample where `power_on_times` knows no start."""
    if not starts:
        return np.asarray(t - t[0]) if len(t) else np.empty(0)
    begun, power_on = (np.array([(start[k] - t_zero_ns) * 1e-9 for start in starts]) for k in (0, 1))
    # A nanosecond of slack: t and the first sample of a start are rounded from the same count of ns.
    place = np.maximum(np.searchsorted(begun, t + 1e-9, side="right") - 1, 0)
    return np.asarray(t - power_on[place])


def _zeroed(effect: CalibratedEffect) -> CalibratedEffect:
    """The effect without its size; a time constant is none, and stays."""
    return replace(
        effect,
        parameters={
            name: q if name == "time_constant" else Quantity(0.0, q.sigma)
            for name, q in effect.parameters.items()
        },
    )


def _xyz(effect: CalibratedEffect) -> Array:
    return np.array([effect.value(axis) for axis in XYZ])


def _times(matrix: Array, rows: Array) -> Array:
    """matrix @ row for each row (N, 3), as plain products and sums: the same bits for any N."""
    x, y, z = rows[:, 0], rows[:, 1], rows[:, 2]
    return np.stack([m[0] * x + m[1] * y + m[2] * z for m in matrix], axis=1)


def _inverse(triad: Triad) -> Array:
    return np.asarray(np.linalg.inv(triad.matrix), np.float64)


def _rotation(vector: Array) -> Array:
    """exp([v]x), Rodrigues."""
    angle = float(np.linalg.norm(vector))
    cross = np.array([[0, -vector[2], vector[1]], [vector[2], 0, -vector[0]], [-vector[1], vector[0], 0]])
    if angle == 0.0:
        return np.eye(3)
    return np.asarray(
        np.eye(3) + math.sin(angle) / angle * cross + (1 - math.cos(angle)) / angle**2 * cross @ cross
    )


def _cubic_root(shown: Array, cubic: float) -> Array:
    """w of w + cubic w³ = shown, by a fixed number of Newton steps."""
    rate = shown
    for _ in range(_CUBIC_STEPS):
        rate = rate - (rate + cubic * (rate * rate * rate) - shown) / (1.0 + 3.0 * cubic * (rate * rate))
    return rate


def _clipped(raw: Array, true: Array, limit: float) -> Array:
    """True values, but a raw one at its limit stays at least there."""
    at_limit = np.abs(raw) >= limit
    if not at_limit.any():
        return true
    return np.where(at_limit, np.copysign(np.maximum(np.abs(raw), np.abs(true)), raw), true)


def _temperature(table: Table) -> Array | None:
    if "temperature" not in table:
        return None
    values = table["temperature"]
    known = np.isfinite(values)
    if not known.any():
        return None
    return values if known.all() else np.asarray(np.interp(table.t, table.t[known], values[known]))
