"""Figure of single estimates of Earth rate: each pair, their Allan deviation, rate against temperature."""

from __future__ import annotations

from typing import Any

import numpy as np

from hubodo.pages.drawing import add_legend_above, new_figure
from hubodo.sensors.north.north_estimate import NorthEstimate
from hubodo.sensors.north.programme import fit_ergodicity
from hubodo.sensors.north.residuals import compute_residuals
from hubodo.unit_systems import RATE

_POINT_COLOUR, _LINE_COLOUR, _ACROSS_COLOUR, _GRID_COLOUR = "#1d2126", "#1b6ca8", "#d1495b", "#d8dce0"


def describe_estimates(estimate: NorthEstimate) -> str:
    """Return a sentence on the single estimates and on the slope of their Allan deviation."""
    text = "Rate of each pair of stops, or of each turn."
    slope = fit_ergodicity(estimate.rates, neighbours_overlap=bool(estimate.stops))
    if slope is not None:
        verdict = "more pairs help" if slope.is_ergodic else "drift limits the mean of many pairs"
        text += (
            f" The Allan deviation of the estimates falls with the power {slope.slope:+.2f} ± "
            f"{slope.sigma:.2f} of their number (-0.5 for independent ones): {verdict}."
        )
    return text


def estimates_figure(estimate: NorthEstimate) -> Any:
    """Return a matplotlib figure; raise InputError if matplotlib cannot be loaded."""
    residuals = compute_residuals(estimate)
    is_warm = bool(np.isfinite(residuals.temperature).all())
    figure = new_figure(8.0, 7.5 if is_warm else 5.0)
    axes = figure.subplots(3 if is_warm else 2, 1)
    _plot_pairs(axes[0], estimate)
    _plot_deviation(axes[1], estimate)
    rate = RATE.shown()
    if is_warm:
        axes[2].plot(residuals.temperature, residuals.rate * rate.factor, ".", ms=3, color=_POINT_COLOUR)
        axes[2].set_xlabel("temperature, °C")
        axes[2].set_ylabel(f"rate without Earth rate, {rate.name}")
    for one in axes:
        one.grid(True, lw=0.4, color=_GRID_COLOUR)
    add_legend_above(figure)
    return figure


def _plot_pairs(axes: Any, estimate: NorthEstimate) -> None:
    rate = RATE.shown()
    parts = (
        (estimate.rates, "along the first stop", _LINE_COLOUR),
        (estimate.rates_across, "across", _ACROSS_COLOUR),
    )
    for values, label, colour in parts:
        if len(values):
            axes.plot(
                np.arange(1, len(values) + 1),
                values * rate.factor,
                ".-",
                ms=4,
                lw=0.6,
                color=colour,
                label=label,
            )
            axes.axhline(float(values.mean()) * rate.factor, lw=0.8, ls=":", color=colour)
    axes.set_xlabel("pair of stops, or turn; dotted: mean")
    axes.set_ylabel(f"Earth rate, {rate.name}")


def _plot_deviation(axes: Any, estimate: NorthEstimate) -> None:
    rate = RATE.shown()
    fit = fit_ergodicity(estimate.rates, neighbours_overlap=bool(estimate.stops))
    if fit is None:
        axes.text(0.5, 0.5, "too few pairs for an Allan deviation", ha="center", transform=axes.transAxes)
        return
    deviation = fit.adev * rate.factor
    axes.loglog(
        fit.factors, deviation, "o-", ms=4, color=_LINE_COLOUR, label="Allan deviation of the estimates"
    )
    white = deviation[0] * np.sqrt(fit.factors[0] / fit.factors)
    axes.loglog(fit.factors, white, ls=":", color=_POINT_COLOUR, label="independent estimates")
    axes.set_xlabel("pairs averaged")
    axes.set_ylabel(f"deviation, {rate.name}")
