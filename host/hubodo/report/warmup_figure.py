"""Figure of a warm-up: record, models, forecast, and residual of the accepted model."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hubodo.report.drawing import new_figure
from hubodo.sensors.warmup.result import SIGMA_HORIZON_S, WarmupAnalysis

_DEG = math.degrees(1.0)
_POINTS, _DOTS = 200, 1000
"""Number of points of a curve, and of the means plotted."""
_COLOURS = ("#1b6ca8", "#d1495b")


def warmup_figure(report: WarmupAnalysis, title: str) -> Any:
    """Return a matplotlib figure; raise InputError if matplotlib cannot be loaded."""
    figure = new_figure(8.0, 8.0)
    course, left, lags = figure.subplots(3, 1, height_ratios=(3, 1.3, 1.3))
    _course(course, report)
    judged = report.accepted or report.exponential
    t, rest = _averaged(report.t, judged.fit.residual)
    left.plot(t / 60.0, rest * _DEG, ".", ms=2, color="#8a8d91")
    left.set_xlim(course.get_xlim())
    left.set_ylabel("residual, °/s")
    left.set_xlabel(f"time since power-on, min; residual of the {judged.fit.kind}")
    test = judged.autocorrelation
    lags.plot(test.lags, test.autocorrelation, lw=0.6, color=_COLOURS[0])
    for size in (-2, -1, 1, 2):
        lags.axhline(size * test.standard_error, lw=0.6, ls=":", color="#8a8d91")
    lags.set_ylabel("autocorrelation")
    lags.set_xlabel("lag, samples; dotted: 1 and 2 standard errors of white noise")
    for axes in (course, left, lags):
        axes.grid(True, lw=0.3, color="#d8dce0")
    course.set_title(title)
    return figure


def _course(axes: Any, report: WarmupAnalysis) -> None:
    t, means = _averaged(report.t, report.means)
    axes.plot(t / 60.0, means * _DEG, ".", ms=2, color="#8a8d91", label="means")
    for judged, colour in zip((report.exponential, report.next_model), _COLOURS, strict=True):
        if judged is not None:
            fitted = report.means - judged.fit.residual
            axes.plot(report.t / 60.0, fitted * _DEG, lw=1.0, color=colour, label=judged.fit.kind)
    end = float(report.t[-1])
    ahead = np.linspace(float(report.t[0]), end + min(SIGMA_HORIZON_S, 2.0 * end), _POINTS)
    warm = None if report.mean_temperatures is None else np.interp(ahead, report.t, report.mean_temperatures)
    bias, sigma = report.forecast.predict(ahead, warm)
    axes.fill_between(
        ahead / 60.0,
        (bias - sigma) * _DEG,
        (bias + sigma) * _DEG,
        color="#2e7d5b",
        alpha=0.25,
        lw=0,
        label="forecast over all forms, 1 sigma",
    )
    axes.set_ylabel("bias, °/s")
    axes.legend(fontsize=8)


def _averaged(t: np.ndarray[Any, Any], values: np.ndarray[Any, Any]) -> tuple[Any, Any]:
    size = max(1, len(t) // _DOTS)
    count = len(t) // size * size
    return t[:count].reshape(-1, size).mean(axis=1), values[:count].reshape(-1, size).mean(axis=1)
