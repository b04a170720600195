"""Result of the calibration of both triads of a node: effects with sigmas, as JSON and as text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.calibration.triad import Triad, effects_from_triad
from hubodo.effects.gyro import GyroGSensitivity
from hubodo.effects.triad import Sensor
from hubodo.html_table import html_lines, html_table
from hubodo.pages.console import print_lines, print_table
from hubodo.sensors.imu.held_out import CrossValidation
from hubodo.sensors.imu.page import (
    format_gravity_error,
    format_turn_error,
    parameter_headings,
    parameter_rows,
)
from hubodo.sensors.imu.scalar_calibration import ScalarCalibration
from hubodo.sensors.imu.standstills import Standstills
from hubodo.sensors.imu.temperature_result import TemperatureTerms
from hubodo.sensors.imu.turn_calibration import TurnCalibration

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class TriadCalibration:
    """The calibration of a gyro triad, or of a triad by known references.

    Attributes:
        triad: bias at zero specific force, rad/s, and M in the accelerometer's frame unless `method`
            differs.
        covariance: (12, 12) of the bias and of M row by row.
        is_observable: (9,) True for the elements of M that were determined.
        method: reference and data used.
        g_sensitivity, g_sensitivity_sigma: (3, 3) (rad/s)/(m/s²), one row per gyro; None if not
            significant.
        turns: calibration by turns, if used.
        held_out: errors on turns that were not fitted, if available.
        axes: (3,) True for the axes that were measured.
    """

    triad: Triad
    covariance: Array
    is_observable: NDArray[np.bool_]
    method: str
    g_sensitivity: Array | None = None
    g_sensitivity_sigma: Array | None = None
    turns: TurnCalibration | None = None
    held_out: CrossValidation | None = None
    axes: NDArray[np.bool_] = field(default_factory=lambda: np.ones(3, bool))

    def effects(self, sensor: Sensor) -> dict[str, Mapping[str, Quantity]]:
        """Return the parameters by effect name, without the g-sensitivity."""
        is_observable = np.append(self.axes, self.is_observable)
        return effects_from_triad(self.triad, np.sqrt(np.diag(self.covariance)), sensor, is_observable)


@dataclass(frozen=True)
class ImuCalibration:
    """The calibration of both triads of one node.

    Attributes
    ----------
    standstills : Standstills or None
        The standstills used; None for a gyro alone on a rate table.
    gravity : float
        Reference of the accelerometers, m/s².
    accel : ScalarCalibration or None
        Calibration of the accelerometer triad, if measured.
    accel_held_out : CrossValidation or None
        Errors on standstills that were not fitted.
    gyro : TriadCalibration or None
        Calibration of the gyro triad, if measured.
    notes : tuple of str
        Remarks.
    node, output : str
        Name of the node, and path of the calibration file in the result of the verb.
    referenced_accel : TriadCalibration or None
        Calibration of the accelerometer by known references, in place of `accel`.
    temperature : TemperatureTerms or None
        Terms of the temperature; None if it does not change, or is unknown.
    """

    standstills: Standstills | None
    gravity: float
    accel: ScalarCalibration | None
    accel_held_out: CrossValidation | None
    gyro: TriadCalibration | None
    notes: tuple[str, ...]
    node: str = ""
    output: str = ""
    referenced_accel: TriadCalibration | None = None
    temperature: TemperatureTerms | None = None

    def effect_parameters(self) -> Mapping[str, Mapping[str, Quantity]]:
        """Return the parameters by effect name, for calibration and model files.

        Returns
        -------
        mapping
            Value and sigma of each parameter, by effect and parameter name.
        """
        calibration: dict[str, Mapping[str, Quantity]] = {}
        if self.accel is not None:
            calibration |= effects_from_triad(
                self.accel.triad, self.accel.sigma, "accel", self.accel.is_observable
            )
        if self.referenced_accel is not None:
            calibration |= self.referenced_accel.effects("accel")
        if self.temperature is not None:
            calibration |= self.temperature.effects()
        if self.gyro is None:
            return calibration
        calibration |= self.gyro.effects("gyro")
        g_sensitivity, g_sigma = self.gyro.g_sensitivity, self.gyro.g_sensitivity_sigma
        if g_sensitivity is not None and g_sigma is not None:
            names = GyroGSensitivity.rows
            calibration[GyroGSensitivity.name] = {
                names[i][j]: Quantity(float(g_sensitivity[i, j]), float(g_sigma[i, j]))
                for i in (2, 0, 1)
                for j in range(3)
            }
        return calibration

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result of `hubodo calibrate imu`.

        Returns
        -------
        dict
            Effects with sigmas, residuals before and after, static poses and notes.
        """
        effects = {
            name: {p: {"value": q.value, "sigma": q.sigma} for p, q in parameters.items()}
            for name, parameters in self.effect_parameters().items()
        }
        result: dict[str, Any] = {
            "node": self.node,
            "output": self.output,
            "gravity": self.gravity,
            "effects": effects,
            "notes": list(self.notes),
        }
        covariance: dict[str, Any] = {"order": "b_x b_y b_z, then M row by row"}
        if self.accel is not None and self.standstills is not None:
            covariance["accel"] = self.accel.full_covariance.tolist()
            result |= _accel_json(self.standstills, self.accel)
        if self.referenced_accel is not None:
            covariance["accel"] = self.referenced_accel.covariance.tolist()
        if self.accel_held_out is not None:
            held = self.accel_held_out
            result["accel_norm_held_out"] = {"before_rms": held.rms_before, "after_rms": held.rms}
        if self.gyro is not None:
            covariance["gyro"] = self.gyro.covariance.tolist()
        if self.gyro is not None and self.gyro.held_out is not None:
            turns = self.gyro.held_out
            result["turns_held_out_deg"] = {
                "before_rms": math.degrees(turns.rms_before),
                "after_rms": math.degrees(turns.rms),
                "after_maximum": math.degrees(float(turns.error.max())),
            }
        result["covariance"] = covariance
        return result

    def render(self, console: Console) -> None:
        """Print the parameters, then the residuals before and after the calibration.

        Parameters
        ----------
        console : rich.console.Console
            The console to print to.
        """
        title = f"{self.node} → {self.output}" if self.output else self.node
        print_table(console, parameter_headings(), parameter_rows(self), title)
        if self.accel is not None:
            print_lines(console, [f"length of gravity: {format_gravity_error(self.accel_held_out)}"])
        if self.gyro is not None and self.gyro.turns is not None:
            print_lines(console, [f"turns: {format_turn_error(self.gyro.held_out)}"])
        print_lines(console, self.notes, label="note")

    def __repr__(self) -> str:
        effects = ", ".join(self.effect_parameters())
        return f"ImuCalibration({self.node}: {len(self.standstills or ())} poses, {effects})"

    def _repr_html_(self) -> str:
        return html_table(parameter_headings(), parameter_rows(self)) + html_lines(self.notes)


def _accel_json(standstills: Standstills, accel: ScalarCalibration) -> dict[str, Any]:
    """Return the poses and the error of the length of gravity in each; poses of a table have no time."""
    return {
        "poses": {"count": accel.poses.count, "condition": accel.poses.condition},
        "rests": [
            (
                {"row": int(standstills.start[k]) + 1}
                if standstills.are_means
                else {"t": standstills.t[k].tolist()}
            )
            | {"accel": standstills.accel[k].tolist(), "residual": float(accel.residual[k])}
            for k in range(len(standstills))
        ],
        "accel_norm": {"before_rms": _rms(accel.residual_before), "after_rms": _rms(accel.residual)},
    }


def _rms(values: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    return float(np.sqrt(np.mean(values**2)))
