"""Application of a calibration to raw samples: the sensor chain is inverted from its end.

Each stage (host/hubodo/model/README.md) is inverted by the effect that caused it: additive accelerometer
errors are subtracted, then the matrix of that triad is inverted; with the resulting force additive gyro
errors are subtracted, then the gyro's matrix and cubic error are inverted; last, the misalignment of the node
is removed. A channel at its limit stays at the limit, so that clipping remains visible.

Effects that a calibration lacks count as zero; `lever_arm`, `wheel_radius` and `track_width` are not sensor
errors and are left to the odometry. Each sample is processed by itself, so live batches and a whole log give
bit-identical results. The raw log is never rewritten.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import (
    CalibratedEffect,
    Calibration,
    NodeCalibration,
    Quantity,
    build_effects,
    find_node_serial,
)
from hubodo.calibration.triad import triad_matrix
from hubodo.effects import BY_NAME, Effect, SensorChain, effect_of
from hubodo.effects.base import Dependency
from hubodo.effects.sensor_chain import REFERENCE_CELSIUS, REFERENCE_VOLTS
from hubodo.effects.temperature import ScaleTemperature
from hubodo.effects.triad import Sensor, multiply
from hubodo.errors import CalibrationError
from hubodo.recording import Event, Table

_SCALE_ITERATIONS = 8
"""Iterations that invert a scale error of 1 % to rounding errors."""
GYRO_CLIPPING_LIMIT, ACCEL_CLIPPING_LIMIT = 34.8, 156.0
"""rad/s, m/s²: from here on a channel of the widest range (2000 deg/s, 16 g) counts as clipped."""


@dataclass(frozen=True, eq=False)
class SampleCorrection:
    """Correction of the samples of one node, built by `from_calibration`.

    Attributes
    ----------
    effects : effects in the order of the sensor chain.
    gyro_inverse, accel_inverse : (3, 3) inverse of the matrix of each triad.
    """

    effects: tuple[Effect, ...]
    gyro_inverse: Array
    accel_inverse: Array

    @staticmethod
    def from_calibration(node: NodeCalibration) -> SampleCorrection:
        """Return the correction of a node. Raises CalibrationError for implausible numbers."""
        effects = tuple(it for it in build_effects(node.effects) if it.is_invertible and not _is_zero(it))
        for effect in effects:
            why = effect.why_irreversible()
            if why:
                raise CalibrationError(f"the calibration's {effect.name} {why}; recalibrate this node")
        return SampleCorrection(effects, _invert_triad(effects, "gyro"), _invert_triad(effects, "accel"))

    def depends_on(self, condition: Dependency) -> bool:
        """Return True if a corrected effect depends on this condition: age, temperature or supply."""
        return any(effect.depends_on == condition for effect in self.effects)

    def apply(
        self,
        gyro: Array,
        accel: Array,
        *,
        age: Array | None = None,
        temperature: Array | float | None = None,
        supply: Array | float | None = None,
    ) -> tuple[Array, Array]:
        """Return true (gyro, accel) from raw ones, (N, 3) rad/s and m/s².

        age: (N,) s since power-on. temperature: (N,) or scalar, degrees C. supply: (N,) or scalar, V. Effects
        that depend on one of these are ignored if it is None.
        """
        count = len(gyro)
        t = np.zeros(count) if age is None else np.maximum(age, 0.0)
        temperatures = np.broadcast_to(REFERENCE_CELSIUS if temperature is None else temperature, (count,))
        chain = SensorChain(t, np.asarray(temperatures, np.float64), *np.zeros((5, 3, count)))
        chain.supply = REFERENCE_VOLTS if supply is None else supply
        chain.force = self._invert("accel", chain, accel.T - self._additive_errors(chain).accel)
        chain.rate = self._invert("gyro", chain, gyro.T - self._additive_errors(chain).gyro)
        for effect in self.effects:
            effect.rotate_out_of_node(chain)
        return _preserve_clipping(gyro, chain.rate.T, GYRO_CLIPPING_LIMIT), _preserve_clipping(
            accel, chain.force.T, ACCEL_CLIPPING_LIMIT
        )

    def _invert(self, sensor: Sensor, chain: SensorChain, reading: Array) -> Array:
        """Return the true vectors (3, N) of readings without additive errors, (3, N).

        The matrix of the triad is constant; scales that follow the temperature are inverted by iteration.
        """
        inverse = self.gyro_inverse if sensor == "gyro" else self.accel_inverse

        def invert_constant(values: Array) -> Array:
            vectors = multiply(inverse, values)
            for effect in self.effects if sensor == "gyro" else ():
                vectors = effect.remove_nonlinearity(vectors, inverse)
            return vectors

        true = invert_constant(reading)
        for effect in self.effects:
            if isinstance(effect, ScaleTemperature) and effect.sensor == sensor:
                errors = effect.scale_errors(chain.temperature)
                for _ in range(_SCALE_ITERATIONS):
                    true = invert_constant(reading - errors * true)
        return true

    def _additive_errors(self, chain: SensorChain) -> SensorChain:
        """Return a chain whose gyro and accel are the additive errors of a reading.

        The errors are evaluated at the time, temperature, supply and force of the reading.
        """
        errors = replace(chain, gyro=np.zeros_like(chain.gyro), accel=np.zeros_like(chain.accel))
        for effect in self.effects:
            effect.add_offsets(errors)
        return errors


@dataclass(frozen=True)
class AppliedCalibration:
    """A recording's nodes with a calibration applied.

    Attributes
    ----------
    nodes : corrected tables by name.
    remaining : the calibration for the odometry: applied effects have the value 0 and keep their sigma.
    summaries : by node: serial, effects applied, power-on (s on the log's clock, None if unknown).
    warnings : one line each.
    """

    nodes: Mapping[str, Table]
    remaining: Calibration
    summaries: Mapping[str, Mapping[str, Any]]
    warnings: tuple[str, ...]


def apply_calibration(
    nodes: Mapping[str, Table],
    calibration: Calibration,
    *,
    metadata: Mapping[str, str] | None = None,
    events: Iterable[Event] = (),
    t_zero_ns: int = 0,
) -> AppliedCalibration:
    """Apply a calibration to the nodes of a recording; nodes that it lacks stay unchanged.

    metadata, events, t_zero_ns: of the recording, for serials and power-on times; without them a node's
    power-on is its first sample. Raises CalibrationError when the calibration is of a node with another
    serial.
    """
    corrected, summaries, warnings = dict(nodes), {}, []
    known = tuple(events)
    for name, node in calibration.nodes.items():
        if name not in nodes:
            continue
        check_serial(name, node, find_node_serial(metadata or {}, name))
        correction = SampleCorrection.from_calibration(node)
        table = nodes[name]
        starts = find_starts(known, name)
        age = time_since_power_on(table.t, starts, t_zero_ns)
        temperature, supply = _fill_unknown(table, "temperature"), _fill_unknown(table, "supply")
        for quantity, known_values in (("temperature", temperature), ("supply", supply)):
            affected = [effect.name for effect in correction.effects if effect.depends_on == quantity]
            if affected and known_values is None:
                names = " and ".join(affected)
                warnings.append(
                    f"{name}: the log has no {quantity}, so {names} of the calibration is not applied"
                )
        if correction.depends_on("age") and not starts:
            warnings.append(
                f"{name}: the log does not say when the node was switched on; its warm-up is counted from "
                "its first sample"
            )
        gyro, accel = correction.apply(
            table.gyro, table.accel, age=age, temperature=temperature, supply=supply
        )
        columns = dict(table.columns)
        columns |= dict(zip(("gx", "gy", "gz"), gyro.T, strict=True))
        columns |= dict(zip(("ax", "ay", "az"), accel.T, strict=True))
        corrected[name] = Table(columns, table.t_ns)
        summaries[name] = {
            "serial": node.serial,
            "applied": [
                it.name for it in reversed(BY_NAME.values()) if it.is_invertible and it.name in node.effects
            ],
            "power_on": (starts[0][1] - t_zero_ns) * 1e-9 if starts else None,
        }
    return AppliedCalibration(corrected, zero_applied_effects(calibration), summaries, tuple(warnings))


def zero_applied_effects(calibration: Calibration) -> Calibration:
    """Return the calibration that remains for samples to which it has been applied.

    Effects that were corrected are zero, with unchanged sigmas; the others are unchanged.
    """
    nodes = {
        name: replace(
            node,
            effects={
                effect: _zero_values(effect, what) if effect_of(effect).is_invertible else what
                for effect, what in node.effects.items()
            },
        )
        for name, node in calibration.nodes.items()
    }
    return replace(calibration, nodes=nodes)


def check_serial(name: str, node: NodeCalibration, serial: str) -> None:
    """Raise CalibrationError if a calibration belongs to another node than the one with this serial.

    Nothing is checked where either serial is unknown.
    """
    if node.serial and serial and node.serial.lower() != serial.lower():
        raise CalibrationError(
            f"the calibration of {name!r} is for the node with serial {node.serial}, the log has {serial} "
            "there; give that node's own calibration, or calibrate this one"
        )


def find_starts(events: Iterable[Event], node: str) -> list[tuple[int, int]]:
    """Return times of first sample and power-on, ns, for each start of a node in the events, oldest first."""
    return sorted(
        (event.t_ns, int(event.data["power_on_ns"]))
        for event in events
        if event.kind == "started" and event.source == node and "power_on_ns" in event.data
    )


def time_since_power_on(t: Array, starts: list[tuple[int, int]], t_zero_ns: int) -> Array:
    """Return the s since power-on, (N,), at times t (N,), s; since the first sample if no start is known."""
    if not starts:
        return np.asarray(t - t[0]) if len(t) else np.empty(0)
    first_samples, power_on = (np.array([(start[k] - t_zero_ns) * 1e-9 for start in starts]) for k in (0, 1))
    # A tolerance of one nanosecond: t and the first sample of a start are rounded from the same ns.
    start = np.maximum(np.searchsorted(first_samples, t + 1e-9, side="right") - 1, 0)
    return np.asarray(t - power_on[start])


def _zero_values(name: str, effect: CalibratedEffect) -> CalibratedEffect:
    """Return the effect with zero size; parameters with another default, such as a time constant, stay."""
    kind = effect_of(name)
    parameters = {
        parameter: q if kind.default(parameter) else Quantity(0.0, q.sigma)
        for parameter, q in effect.parameters.items()
    }
    return replace(effect, parameters=parameters)


def _is_zero(effect: Effect) -> bool:
    return all(value == 0.0 for name, value in effect.values().items() if not effect.default(name))


def _invert_triad(effects: Iterable[Effect], sensor: Sensor) -> Array:
    matrix = triad_matrix(effects, sensor)
    if not 0.5 < abs(float(np.linalg.det(matrix))) < 2.0:
        raise CalibrationError(
            f"the calibration's {sensor}_scale_factor and {sensor}_nonorthogonality are no valid triad; "
            "recalibrate this node"
        )
    return np.asarray(np.linalg.inv(matrix), np.float64)


def _preserve_clipping(raw: Array, corrected: Array, limit: float) -> Array:
    """Return corrected values; a raw value at the range limit is not corrected to a smaller magnitude."""
    at_limit = np.abs(raw) >= limit
    if not at_limit.any():
        return corrected
    return np.where(at_limit, np.copysign(np.maximum(np.abs(raw), np.abs(corrected)), raw), corrected)


def _fill_unknown(table: Table, column: str) -> Array | None:
    if column not in table:
        return None
    values = table[column]
    known = np.isfinite(values)
    if not known.any():
        return None
    return values if known.all() else np.asarray(np.interp(table.t, table.t[known], values[known]))
