"""Figure of one or several Allan deviations: points, fit, terms, residuals and data sheets."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from itertools import cycle
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.report.drawing import new_figure
from hubodo.sensors.allan.characterise import AllanAnalysis
from hubodo.sensors.allan.covariance import TERMS, design_matrix
from hubodo.sensors.allan.datasheet import Datasheet
from hubodo.sensors.allan.ieee952 import rate_unit, term_units

_INK, _GRID = "#1d2126", "#d8dce0"
_LINES = {"Q": "#8a6d3b", "N": "#1b6ca8", "B": "#2e7d5b", "K": "#d1495b", "R": "#7a4fa3"}
_SENSORS = ("#1b6ca8", "#d1495b", "#2e7d5b", "#7a4fa3", "#8a6d3b", "#1d2126", "#c2570c", "#0e7490")
_MARKS = "osD^vPX*"
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def allan_figure(
    reports: Sequence[tuple[str, AllanAnalysis]], title: str, sheets: Sequence[Datasheet] = ()
) -> Any:
    """Return a matplotlib figure of one channel with its terms, or of several channels of one kind of sensor.

    reports: label and analysis of each channel. sheets: data sheets for comparison. Raises InputError if matplotlib
    cannot be loaded.
    """
    unit = rate_unit(reports[0][1].channel)
    made = new_figure(8.0, 7.0)
    upper, lower = made.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    several = len(reports) > 1
    for (name, report), colour, mark in zip(reports, cycle(_SENSORS), cycle(_MARKS), strict=False):
        colour = colour if several else _INK
        _points(upper, report, name if several else "measured, 95 %", colour, mark)
        _residuals(lower, report, colour, mark)
    if not several:
        _terms(upper, reports[0][1])
    tau = _span([report for _, report in reports])
    for sheet, dash in zip(sheets, cycle((":", "-.", (0, (1, 3)))), strict=False):
        upper.plot(
            tau,
            sheet.deviation(reports[0][1].channel, tau),
            ls=dash,
            color="#5d646c",
            lw=1.5,
            label=f"{sheet.name}, data sheet",
        )
    upper.set_xscale("log")
    upper.set_yscale("log")
    upper.set_ylim(
        min(_bottom(report) for _, report in reports),
        max(float(report.points.adev.max()) for _, report in reports) * 1.5,
    )
    upper.set_ylabel(f"Allan deviation, {unit.si}")
    right = upper.secondary_yaxis("right", functions=(_scaled(unit.factor), _scaled(1.0 / unit.factor)))
    right.set_ylabel(unit.common)
    upper.legend(fontsize=8)
    upper.set_title(title)
    lower.axhline(0.0, color=_INK, lw=0.8)
    lower.set_ylabel("residual, %")
    lower.set_xlabel("averaging time, s")
    for axes in (upper, lower):
        axes.grid(True, which="major", lw=0.4, color=_GRID)
    for axis in (upper.xaxis, upper.yaxis, right.yaxis):
        _written_plainly(axis)
    return made


def _written_plainly(axis: Any) -> None:
    """Format powers of ten as plain text, because rendering formulae takes a third of the time of a figure."""
    from matplotlib.ticker import LogFormatterSciNotation

    class Plain(LogFormatterSciNotation):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return _letters(super().__call__(x, pos))

    axis.set_major_formatter(Plain())
    axis.set_minor_formatter(Plain(labelOnlyBase=False))


def _letters(formula: str) -> str:
    r"""Return `10⁻³` for `$\mathdefault{10^{-3}}$`; text without exponent is unchanged."""
    text = formula.removeprefix(r"$\mathdefault{").removesuffix("}$").replace(r"\times", "×")
    return re.sub(r"\^\{(-?\d+)\}", lambda found: found[1].translate(_RAISED), text)


def _points(axes: Any, report: AllanAnalysis, label: str, colour: str, mark: str) -> None:
    points = report.points
    bars = [points.adev - report.low, report.high - points.adev]
    axes.errorbar(points.tau, points.adev, bars, fmt=mark, ms=4, lw=1, color=colour, label=label)
    tau = _span([report])
    axes.plot(tau, np.sqrt(report.fit.variance(tau)), color=colour, lw=1.3)


def _terms(axes: Any, report: AllanAnalysis) -> None:
    """Plot the asymptotes of the significant terms, and the best averaging time."""
    tau = _span([report])
    for column, name in zip(design_matrix(tau).T, TERMS, strict=True):
        term, unit = report.fit.terms[name], term_units(report.channel)[name]
        if term.value is not None:
            line = term.value * np.sqrt(column)
            label = f"{name} = {term.value * unit.factor:.3g} {unit.common}"
            axes.plot(tau, line, "--", color=_LINES[name], lw=1, label=label)
    if report.best_tau is not None:
        axes.axvline(report.best_tau, color="#8a8d91", lw=0.8)


def _residuals(axes: Any, report: AllanAnalysis, colour: str, mark: str) -> None:
    """Plot the relative residuals in %; hollow markers for points that were not fitted."""
    points = report.points
    fitted = np.sqrt(report.fit.variance(points.tau))
    used = np.isin(points.factors, report.fit.factors)
    y, error = 100.0 * (points.adev / fitted - 1.0), 100.0 * report.sigma / fitted
    axes.errorbar(points.tau[used], y[used], error[used], fmt=mark, ms=4, lw=1, color=colour)
    axes.plot(points.tau[~used], y[~used], mark, ms=4, color=colour, mfc="none")
    reach = float(np.max(np.abs(y[used]) + error[used], initial=1.0))
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -reach), max(high, reach))


def _span(reports: Sequence[AllanAnalysis]) -> Array:
    first = min(float(report.points.tau[0]) for report in reports)
    last = max(float(report.points.tau[-1]) for report in reports)
    return np.geomspace(first, last, 200)


def _scaled(factor: float) -> Callable[[Any], Any]:
    """Return a function that multiplies by a factor, for the second axis."""
    return lambda y: y * factor


def _bottom(report: AllanAnalysis) -> float:
    """Return the lower limit of the figure: below all points and below the bias instability."""
    floor = math.sqrt(2.0 * math.log(2.0) / math.pi) * (report.fit.terms["B"].value or math.inf)
    return 0.7 * min(float(report.low.min()), floor)
