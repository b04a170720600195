"""Result of `hubodo calibrate rate`: figures of a gyro axis on a rate table, as JSON and as text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hubodo.calibration.file import Quantity
from hubodo.calibration.parameter_table import format_with_sigma
from hubodo.html_table import html_lines, html_table
from hubodo.pages.console import print_lines, print_table
from hubodo.sensors.rate_table.fit import RateTableFit
from hubodo.sensors.rate_table.plateaus import Plateaus
from hubodo.unit_systems import RATE, RATE_RAMP, RATE_SAMPLE, RATIO

if TYPE_CHECKING:
    from rich.console import Console

_HEADINGS = ("figure", "value ± 1σ", "unit")
SIGNIFICANT_P_VALUE = 0.01
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
        headings, *rows = self._rate_rows()
        print_table(console, headings, rows)
        print_lines(console, self.notes, label="note")

    def _rows(self) -> list[tuple[str, ...]]:
        fit, bias, ratio = self.fit, RATE.shown(), RATIO.shown()
        drift, of_scale = RATE_RAMP.shown(), ratio.factor / self.full_scale
        full = f"{ratio.name} of full scale"
        rows: list[tuple[str, ...]] = [
            ("scale error", _cell(fit.scale_error, ratio.factor), ratio.name),
            ("bias", _cell(self.bias, bias.factor), bias.name),
            ("asymmetry", _cell(fit.asymmetry, ratio.factor), ratio.name),
            ("nonlinearity, largest deviation", _cell(fit.nonlinearity, of_scale), full),
            ("hysteresis, from below minus from above", _cell(fit.hysteresis, of_scale), full),
            ("bias drift", _cell(fit.drift, drift.factor), drift.name),
        ]
        if not self.is_nonlinear:
            rows[3] = (rows[3][0], f"not significant, below {ratio.factor * self._bound():.3g}", rows[3][2])
        return rows

    def _rate_rows(self) -> list[tuple[str, ...]]:
        """Return a row of headings, then the deviation of each rate."""
        ratio, rate, fit = RATIO.shown(), RATE_SAMPLE.shown(), self.fit
        of_scale = ratio.factor / self.full_scale
        return [
            (f"rate, {rate.name}", f"deviation from the line ± 1σ, {ratio.name} of full scale"),
            *(
                (f"{r * rate.factor:.4g}", format_with_sigma(float(d) * of_scale, float(s) * of_scale))
                for r, d, s in zip(fit.rates, fit.deviation, fit.deviation_sigma, strict=True)
            ),
        ]

    def _bound(self) -> float:
        """Return the 95 % bound of the largest deviation, relative to full scale."""
        worst = self.fit.nonlinearity
        return (abs(worst.value) + _TWO_SIDED_95 * worst.sigma) / self.full_scale

    def __repr__(self) -> str:
        return f"RateCalibration({self.node} g{self.axis}: {len(self.plateaus.rate)} plateaus)"

    def _repr_html_(self) -> str:
        headings, *rows = self._rate_rows()
        return html_table(_HEADINGS, self._rows()) + html_table(headings, rows) + html_lines(self.notes)


def _json(quantity: Quantity | None, factor: float = 1.0) -> dict[str, float] | None:
    if quantity is None:
        return None
    return {"value": quantity.value * factor, "sigma": quantity.sigma * factor}


def _cell(quantity: Quantity | None, factor: float) -> str:
    if quantity is None:
        return "not observable"
    return format_with_sigma(quantity.value * factor, quantity.sigma * factor)
