"""Result of `hubodo calibrate rate`: figures of a gyro axis on a rate table, as JSON and as text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hubodo.calibration.file import Quantity
from hubodo.calibration.parameter_table import COMMON_UNITS, format_with_sigma
from hubodo.html_table import html_lines, html_table
from hubodo.pages.console import print_lines, print_table
from hubodo.sensors.rate_table.fit import RateTableFit
from hubodo.sensors.rate_table.plateaus import Plateaus

if TYPE_CHECKING:
    from rich.console import Console

_HEADINGS = ("figure", "value ± 1σ", "unit")
_RATE_HEADINGS = ("rate, deg/s", "deviation from the line ± 1σ, ppm of full scale")
SIGNIFICANT_P_VALUE = 0.01
_PPM, _DEG_PER_H = (COMMON_UNITS[unit][0] for unit in ("1", "rad/s"))
_TWO_SIDED_95 = 1.96


@dataclass(frozen=True)
class RateCalibration:
    """The calibration of one gyro axis on a rate table.

    Attributes
    ----------
    node, axis, output : str
        Name of the node, its axis, and path of the calibration file.
    full_scale : float
        Rate that nonlinearity and hysteresis refer to, rad/s.
    plateaus : Plateaus
        The plateaus used.
    fit : RateTableFit
        The figures with their sigmas.
    bias : Quantity
        Bias without Earth rate, rad/s, in its sigma if the latitude is unknown.
    notes : tuple of str
        Remarks.
    """

    node: str
    axis: str
    full_scale: float
    plateaus: Plateaus
    fit: RateTableFit
    bias: Quantity
    notes: tuple[str, ...] = ()
    output: str = ""

    def effect_parameters(self) -> Mapping[str, Mapping[str, Quantity]]:
        """Return bias and scale error by effect name, for the calibration file.

        Returns
        -------
        mapping
            Value and sigma of each parameter, by effect and parameter name.
        """
        return {"gyro_bias": {self.axis: self.bias}, "gyro_scale_factor": {self.axis: self.fit.scale_error}}

    @property
    def is_nonlinear(self) -> bool:
        """Return True if chance does not explain the deviations from the line."""
        return self.fit.nonlinearity_p_value < SIGNIFICANT_P_VALUE

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result of `hubodo calibrate rate`, in SI units; ratios are relative to full scale.

        Returns
        -------
        dict
            Figures with sigmas, deviations by rate, plateaus, effects and notes.
        """
        fit, scale = self.fit, self.full_scale
        return {
            "node": self.node,
            "axis": self.axis,
            "output": self.output,
            "full_scale": scale,
            "bias": _json(self.bias),
            "scale_error": _json(fit.scale_error),
            "asymmetry": _json(fit.asymmetry),
            "nonlinearity": {
                **(_json(fit.nonlinearity, 1.0 / scale) or {}),
                "upper_bound": self._bound(),
                "p_value": fit.nonlinearity_p_value,
            },
            "hysteresis": _json(fit.hysteresis, 1.0 / scale),
            "bias_drift": _json(fit.drift),
            "noise_factor": fit.noise_factor,
            "deviations": [
                {"rate": float(r), "value": float(d) / scale, "sigma": float(s) / scale}
                for r, d, s in zip(fit.rates, fit.deviation, fit.deviation_sigma, strict=True)
            ],
            "plateaus": [
                {"t": float(t), "rate": float(r), "reading": float(y), "sigma": float(s)}
                for t, r, y, s in zip(
                    self.plateaus.t,
                    self.plateaus.rate,
                    self.plateaus.reading,
                    self.plateaus.sigma,
                    strict=True,
                )
            ],
            "effects": {
                name: {p: _json(q) for p, q in parameters.items()}
                for name, parameters in self.effect_parameters().items()
            },
            "notes": list(self.notes),
        }

    def render(self, console: Console) -> None:
        """Print the figures, then the deviation of each rate.

        Parameters
        ----------
        console : rich.console.Console
            The console to print to.
        """
        title = f"{self.node} g{self.axis}" + (f" → {self.output}" if self.output else "")
        print_table(console, _HEADINGS, self._rows(), title)
        print_table(console, _RATE_HEADINGS, self._rate_rows())
        print_lines(console, self.notes, label="note")

    def _rows(self) -> list[tuple[str, ...]]:
        fit, of_scale = self.fit, _PPM / self.full_scale
        rows: list[tuple[str, ...]] = [
            ("scale error", _cell(fit.scale_error, _PPM), "ppm"),
            ("bias", _cell(self.bias, _DEG_PER_H), "°/h"),
            ("asymmetry", _cell(fit.asymmetry, _PPM), "ppm"),
            ("nonlinearity, largest deviation", _cell(fit.nonlinearity, of_scale), "ppm of full scale"),
            ("hysteresis, from below minus from above", _cell(fit.hysteresis, of_scale), "ppm of full scale"),
            ("bias drift", _cell(fit.drift, _DEG_PER_H * 3600.0), "°/h per hour"),
        ]
        if not self.is_nonlinear:
            rows[3] = (rows[3][0], f"not significant, below {_PPM * self._bound():.3g}", rows[3][2])
        return rows

    def _rate_rows(self) -> list[tuple[str, ...]]:
        of_scale, fit = _PPM / self.full_scale, self.fit
        return [
            (f"{math.degrees(r):.4g}", format_with_sigma(float(d) * of_scale, float(s) * of_scale))
            for r, d, s in zip(fit.rates, fit.deviation, fit.deviation_sigma, strict=True)
        ]

    def _bound(self) -> float:
        """Return the 95 % bound of the largest deviation, relative to full scale."""
        worst = self.fit.nonlinearity
        return (abs(worst.value) + _TWO_SIDED_95 * worst.sigma) / self.full_scale

    def __repr__(self) -> str:
        return f"RateCalibration({self.node} g{self.axis}: {len(self.plateaus.rate)} plateaus)"

    def _repr_html_(self) -> str:
        return (
            html_table(_HEADINGS, self._rows())
            + html_table(_RATE_HEADINGS, self._rate_rows())
            + html_lines(self.notes)
        )


def _json(quantity: Quantity | None, factor: float = 1.0) -> dict[str, float] | None:
    if quantity is None:
        return None
    return {"value": quantity.value * factor, "sigma": quantity.sigma * factor}


def _cell(quantity: Quantity | None, factor: float) -> str:
    if quantity is None:
        return "not observable"
    return format_with_sigma(quantity.value * factor, quantity.sigma * factor)
