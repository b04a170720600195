"""Temperatures of static poses, and the order of the polynomial that a quantity follows.

The order is the highest at which both the F-test of the misfit and the error of held-out poses decide for
the further term. Between two records a bias changes, its dependence on the temperature hardly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from hubodo.arrays import Array
from hubodo.effects.sensor_chain import REFERENCE_CELSIUS
from hubodo.errors import CalibrationError
from hubodo.sensors.imu.standstills import Standstills

MIN_SPAN = 3.0
"""°C between the coldest and the hottest pose: with less, the drift of a bias in time looks the same."""
MAX_ORDER = 3
MAX_P_VALUE = 0.01
"""Largest p-value, corrected for the number of trials, at which a term is included."""
MIN_DOF = 4
"""Degrees of freedom of the misfit that remain beside all terms."""
_ONE_WAY_SHARE = 0.9
"""Correlation of temperature and time beyond which a drift in time is not separable."""

Fit = TypeVar("Fit")


@dataclass(frozen=True)
class PoseTemperature:
    """Temperatures of the samples of a record, (N,), and of its R poses, °C.

    Attributes:
        samples: (N,) with gaps interpolated.
        poses: (R,) means.
        rates: (R,) °C/s, slope at the pose.
        is_one_way: True if the temperature only rises, or only falls, with time.
    """

    samples: Array
    poses: Array
    rates: Array
    is_one_way: bool

    def select(self, which: NDArray[np.bool_]) -> PoseTemperature:
        """Return the temperatures of the selected poses."""
        return PoseTemperature(self.samples, self.poses[which], self.rates[which], self.is_one_way)

    def powers(self, order: int) -> Array:
        """Return the (R, order) powers of the difference of the poses from 25 °C."""
        return powers_of(self.poses, order)


def powers_of(temperature: Array, order: int) -> Array:
    """Return the (N, order) powers 1, 2, ... of the difference of temperatures (N,) from 25 °C."""
    return np.asarray((temperature - REFERENCE_CELSIUS)[:, None] ** np.arange(1, order + 1))


def measure_pose_temperature(
    t: Array, temperature: Array | None, standstills: Standstills, *, is_required: bool
) -> PoseTemperature | None:
    """Return the temperatures of the standstills, or None if they span less than `MIN_SPAN`.

    is_required: raise CalibrationError in place of None.
    """
    known = np.zeros(0, bool) if temperature is None else np.isfinite(temperature)
    if temperature is None or not known.any():
        if is_required:
            raise CalibrationError(
                "the record has no temperature, so terms of the temperature cannot be determined; leave out "
                "--temperature-order, or record with a thermometer"
            )
        return None
    samples = np.interp(t, t[known], temperature[known])
    spans = list(zip(standstills.start, standstills.end, strict=True))
    poses = np.array([samples[i:j].mean() for i, j in spans])
    if len(poses) < 2 or float(np.ptp(poses)) < MIN_SPAN:
        if is_required:
            raise CalibrationError(
                f"the poses span {float(np.ptp(poses)) if len(poses) else 0.0:.2g} °C, {MIN_SPAN:g} °C are "
                "needed to determine terms of the temperature; heat and cool the node over the poses, or "
                "leave out --temperature-order"
            )
        return None
    middle = standstills.t.mean(axis=1)
    rates = np.gradient(poses, middle)
    is_one_way = abs(float(np.corrcoef(poses, middle)[0, 1])) > _ONE_WAY_SHARE
    return PoseTemperature(samples, poses, rates, is_one_way)


def select_model(
    fit: Callable[[tuple[int, ...]], tuple[Fit, float, float, float]],
    start: tuple[int, ...],
    further: Callable[[tuple[int, ...]], list[tuple[int, ...]]],
    width: int,
) -> tuple[Fit, tuple[int, ...]]:
    """Return the last fit that each further term improves significantly, and its model.

    fit: returns a fit of a model, its misfit, degrees of freedom, and the squared error of held-out poses;
    raises CalibrationError if it fails. start: simplest model. further: larger models to try after one.
    width: parameters that a unit of a model's sum adds.
    """
    model, (best, misfit, _, held_out) = start, fit(start)
    while trials := further(model):
        accepted = []
        for trial in trials:
            try:
                result, smaller, dof, error = fit(trial)
            except (CalibrationError, np.linalg.LinAlgError):
                continue
            if dof < MIN_DOF or error >= held_out:
                continue
            added = width * (sum(trial) - sum(model))
            ratio = (misfit - smaller) / added * dof / max(smaller, 1e-300)
            p_value = float(fdtrc(added, dof, max(ratio, 0.0))) * len(trials)
            if p_value < MAX_P_VALUE:
                accepted.append((p_value, trial, result, smaller, error))
        if not accepted:
            break
        _, model, best, misfit, held_out = min(accepted, key=lambda it: (it[0], it[3]))
    return best, model
