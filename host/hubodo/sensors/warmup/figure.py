"""Figure of a warm-up: record, models, forecast, and residual of the accepted model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hubodo.pages.drawing import add_legend_above, new_figure
from hubodo.sensors.warmup.forecast import SIGMA_HORIZON_S
from hubodo.unit_systems import RATE, RATE_SAMPLE

if TYPE_CHECKING:
    from hubodo.sensors.warmup.result import WarmupResult

_CURVE_POINTS, _MAX_DOTS = 200, 1000
"""Number of points of a curve, and of the means plotted."""
_MODEL_COLOURS = ("#1b6ca8", "#d1495b")


def warmup_figure(result: WarmupResult, title: str) -> Any:
    """Return a matplotlib figure; raise InputError if matplotlib cannot be loaded."""
    figure = new_figure(8.0, 8.0)
    bias_axes, residual_axes, lag_axes = figure.subplots(3, 1, height_ratios=(3, 1.3, 1.3))
    _plot_bias(bias_axes, result)
    assessed, unit = result.accepted or result.exponential, RATE.shown(RATE_SAMPLE)
    t, residual = _averaged(result.t, assessed.fit.residual)
    residual_axes.plot(t / 60.0, residual * unit.factor, ".", ms=2, color="#8a8d91")
    residual_axes.set_xlim(bias_axes.get_xlim())
    residual_axes.set_ylabel(f"residual, {unit.name}")
    residual_axes.set_xlabel(f"time since power-on, min; residual of the {assessed.fit.kind}")
    test = assessed.autocorrelation
    lag_axes.plot(test.lags, test.autocorrelation, lw=0.6, color=_MODEL_COLOURS[0])
    for size in (-2, -1, 1, 2):
        lag_axes.axhline(size * test.standard_error, lw=0.6, ls=":", color="#8a8d91")
    lag_axes.set_ylabel("autocorrelation")
    lag_axes.set_xlabel("lag, samples; dotted: 1 and 2 standard errors of white noise")
    for axes in (bias_axes, residual_axes, lag_axes):
        axes.grid(True, lw=0.3, color="#d8dce0")
    bias_axes.set_title(title)
    return figure


def temperature_figure(result: WarmupResult) -> Any:
    """Return a matplotlib figure of the means, and of the accepted model, against the temperature."""
    figure = new_figure(8.0, 4.0)
    axes, unit = figure.subplots(), RATE.shown(RATE_SAMPLE)
    assert result.mean_temperatures is not None
    (_, means), (_, degrees) = (_averaged(result.t, it) for it in (result.means, result.mean_temperatures))
    is_rising = np.gradient(_smoothed(degrees)) >= 0.0
    labels = ("rising", "falling")
    for part, label, colour in zip((is_rising, ~is_rising), labels, _MODEL_COLOURS, strict=True):
        axes.plot(degrees[part], means[part] * unit.factor, ".", ms=2, color=colour, label=label)
    if result.accepted is not None and result.accepted.fit.temperature_order:
        order = np.argsort(result.mean_temperatures)
        fitted = (result.means - result.accepted.fit.residual)[order] * unit.factor
        axes.plot(result.mean_temperatures[order], fitted, lw=1.0, color="#2e7d5b", label="accepted model")
    axes.set_xlabel("temperature, °C")
    axes.set_ylabel(f"bias, {unit.name}")
    axes.grid(True, lw=0.3, color="#d8dce0")
    add_legend_above(figure)
    return figure


def _smoothed(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the running mean over a twentieth of the values."""
    width = max(1, len(values) // 20)
    padded = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), "valid")


def _plot_bias(axes: Any, result: WarmupResult) -> None:
    unit = RATE.shown(RATE_SAMPLE)
    t, means = _averaged(result.t, result.means)
    axes.plot(t / 60.0, means * unit.factor, ".", ms=2, color="#8a8d91", label="means")
    for assessed, colour in zip((result.exponential, result.next_model), _MODEL_COLOURS, strict=True):
        if assessed is not None:
            fitted = result.means - assessed.fit.residual
            axes.plot(result.t / 60.0, fitted * unit.factor, lw=1.0, color=colour, label=assessed.fit.kind)
    end = float(result.t[-1])
    ages = np.linspace(float(result.t[0]), end + min(SIGMA_HORIZON_S, 2.0 * end), _CURVE_POINTS)
    temperatures = (
        None if result.mean_temperatures is None else np.interp(ages, result.t, result.mean_temperatures)
    )
    bias, sigma = result.forecast.predict(ages, temperatures)
    axes.fill_between(
        ages / 60.0,
        (bias - sigma) * unit.factor,
        (bias + sigma) * unit.factor,
        color="#2e7d5b",
        alpha=0.25,
        lw=0,
        label="forecast over all forms, 1 sigma",
    )
    axes.set_ylabel(f"bias, {unit.name}")
    add_legend_above(axes.figure)


def _averaged(t: np.ndarray[Any, Any], values: np.ndarray[Any, Any]) -> tuple[Any, Any]:
    size = max(1, len(t) // _MAX_DOTS)
    count = len(t) // size * size
    return t[:count].reshape(-1, size).mean(axis=1), values[:count].reshape(-1, size).mean(axis=1)
