"""A calibration applied on read: raw samples to true ones, the sensor chain undone from its end.

Stage by stage (the model's README, host/hubodo/model/README.md), each by the effect that made it: what
accelerometer effects add comes off, then the matrix of that triad is inverted; with the force so found, what
gyro effects add comes off, then their matrix and curvature are undone; last the node is turned back. A
channel at its limit stays there: what is clipped must be seen to be clipped.

What a calibration does not hold counts as zero; `lever_arm`, `wheel_radius` and `track_width` are no errors
of the sensor and go on to the odometry. Every step works sample by sample without sums over samples, so a
live run in portions and a log in one piece give the same bits. The raw log is never rewritten.
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
from hubodo.effects.base import REFERENCE_CELSIUS, REFERENCE_VOLTS, Dependency
from hubodo.effects.triad import Sensor, multiply
from hubodo.errors import CalibrationError
from hubodo.recording import Event, Table

GYRO_CLIPPING_LIMIT, ACCEL_CLIPPING_LIMIT = 34.8, 156.0
"""rad/s, m/s²: from here on a channel of the widest range (2000 deg/s, 16 g) is taken to be clipped."""


@dataclass(frozen=True, eq=False)
class SampleCorrection:
    """What is undone in the samples of one node; `from_calibration` makes it.

    effects: in the order of the chain. gyro, accel: (3, 3) inverse of the matrix of each triad.
    """

    effects: tuple[Effect, ...]
    gyro_inverse: Array
    accel_inverse: Array

    @staticmethod
    def from_calibration(node: NodeCalibration) -> SampleCorrection:
        """The correction of a node. Raises CalibrationError for numbers that no sensor has."""
        effects = tuple(it for it in build_effects(node.effects) if it.is_invertible and not _is_zero(it))
        for effect in effects:
            why = effect.why_irreversible()
            if why:
                raise CalibrationError(f"the calibration's {effect.name} {why}; calibrate this node anew")
        return SampleCorrection(effects, _invert_triad(effects, "gyro"), _invert_triad(effects, "accel"))

    def depends_on(self, condition: Dependency) -> bool:
        """Whether something that is undone depends on the age, the temperature, or the supply."""
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
        """True (gyro, accel) from raw ones, (N, 3) rad/s and m/s².

        age: (N,) s since power-on, for the warm-up, which is left out without. temperature: (N,) or one,
        degrees C; supply: the same, V; their terms are left out without.
        """
        count = len(gyro)
        t = np.zeros(count) if age is None else np.maximum(age, 0.0)
        temperatures = np.broadcast_to(REFERENCE_CELSIUS if temperature is None else temperature, (count,))
        chain = SensorChain(t, np.asarray(temperatures, np.float64), *np.zeros((5, 3, count)))
        chain.supply = REFERENCE_VOLTS if supply is None else supply
        chain.force = multiply(self.accel_inverse, accel.T - self._additive_errors(chain).accel)
        chain.rate = multiply(self.gyro_inverse, gyro.T - self._additive_errors(chain).gyro)
        for effect in self.effects:
            chain.rate = effect.remove_nonlinearity(chain.rate, self.gyro_inverse)
        for effect in self.effects:
            effect.rotate_out_of_node(chain)
        return _preserve_clipping(gyro, chain.rate.T, GYRO_CLIPPING_LIMIT), _preserve_clipping(
            accel, chain.force.T, ACCEL_CLIPPING_LIMIT
        )

    def _additive_errors(self, chain: SensorChain) -> SensorChain:
        """A chain whose gyro and accel are what the effects add to a reading.

        The reading is of its time, temperature, supply and force.
        """
        errors = replace(chain, gyro=np.zeros_like(chain.gyro), accel=np.zeros_like(chain.accel))
        for effect in self.effects:
            effect.add_offsets(errors)
        return errors


@dataclass(frozen=True)
class AppliedCalibration:
    """A recording's nodes with a calibration applied.

    nodes: by name. left: the calibration for the odometry: what was applied has the value 0 and keeps its
    sigma, all else is as in the file. used: by node serial, effects applied, power-on (s on the log's clock,
    None when it is not known). warnings: one line each.
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
    """Apply a calibration to the nodes of a recording; nodes that it does not know stay as they are.

    metadata, events, t_zero_ns: of the recording; they tell serials and when the nodes were switched on;
    where they do not, power-on is taken to be a node's first sample. Raises CalibrationError when the
    calibration was made for a node with another serial.
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
    """The calibration as it holds for samples that it has been applied to.

    The errors that were taken out are zero, as surely as they were known; the others stand as they were.
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
    """Raises CalibrationError when a calibration is of another node than the one with this serial.

    Where one of the two is not known, nothing can be checked.
    """
    if node.serial and serial and node.serial.lower() != serial.lower():
        raise CalibrationError(
            f"the calibration of {name!r} is for the node with serial {node.serial}, the log has {serial} "
            "there; give that node's own calibration, or calibrate this one"
        )


def find_starts(events: Iterable[Event], node: str) -> list[tuple[int, int]]:
    """(first sample, power-on), ns, of each start of a node that a log knows of, oldest first."""
    return sorted(
        (event.t_ns, int(event.data["power_on_ns"]))
        for event in events
        if event.kind == "started" and event.source == node and "power_on_ns" in event.data
    )


def time_since_power_on(t: Array, starts: list[tuple[int, int]], t_zero_ns: int) -> Array:
    """(N,) s since power-on at t (N,) s; since the first sample where `find_starts` finds no start."""
    if not starts:
        return np.asarray(t - t[0]) if len(t) else np.empty(0)
    first_samples, power_on = (np.array([(start[k] - t_zero_ns) * 1e-9 for start in starts]) for k in (0, 1))
    # A nanosecond of slack: t and the first sample of a start are rounded from the same count of ns.
    start = np.maximum(np.searchsorted(first_samples, t + 1e-9, side="right") - 1, 0)
    return np.asarray(t - power_on[start])


def _zero_values(name: str, effect: CalibratedEffect) -> CalibratedEffect:
    """The effect without its size; what is not zero in an effect that is absent, a time constant, is none."""
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
            f"the calibration's {sensor}_scale_factor and {sensor}_nonorthogonality leave no triad; "
            "calibrate this node anew"
        )
    return np.asarray(np.linalg.inv(matrix), np.float64)


def _preserve_clipping(raw: Array, corrected: Array, limit: float) -> Array:
    """True values, but a raw one at its limit stays at least there."""
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
