"""Figure of one or several Allan deviations: points, fit, terms, residuals and data sheets."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from hubodo.arrays import Array
from hubodo.pages.drawing import add_legend_above, new_figure
from hubodo.sensors.allan.covariance import TERMS, design_matrix
from hubodo.sensors.allan.datasheet import Datasheet
from hubodo.sensors.allan.ieee952 import rate_unit, term_units
from hubodo.unit_systems import unit_system

if TYPE_CHECKING:
    from hubodo.sensors.allan.result import AllanResult

_POINT_COLOUR, _GRID_COLOUR = "#1d2126", "#d8dce0"
_TERM_COLOURS = {"Q": "#8a6d3b", "N": "#1b6ca8", "B": "#2e7d5b", "K": "#d1495b", "R": "#7a4fa3"}
_CHANNEL_COLOURS = ("#1b6ca8", "#d1495b", "#2e7d5b", "#7a4fa3", "#8a6d3b", "#1d2126", "#c2570c", "#0e7490")
_CHANNEL_MARKERS = "osD^vPX*"
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def allan_figure(
    results: Sequence[tuple[str, AllanResult]], title: str, sheets: Sequence[Datasheet] = ()
) -> Any:
    """Return a matplotlib figure of one channel with its terms, or of several channels of one kind of sensor.

    results: label and result of each channel. sheets: data sheets for comparison. Raises InputError if
    matplotlib cannot be loaded.
    """
    unit = rate_unit(results[0][1].channel)
    plot = new_figure(8.0, 7.0)
    upper, lower = plot.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    several = len(results) > 1
    for (name, result), colour, marker in zip(
        results, cycle(_CHANNEL_COLOURS), cycle(_CHANNEL_MARKERS), strict=False
    ):
        colour = colour if several else _POINT_COLOUR
        _points(upper, result, name if several else "measured, 95 %", colour, marker)
        _residuals(lower, result, colour, marker)
    if not several:
        _terms(upper, results[0][1])
    tau = _tau_range([result for _, result in results])
    for sheet, dash in zip(sheets, cycle((":", "-.", (0, (1, 3)))), strict=False):
        upper.plot(
            tau,
            sheet.deviation(results[0][1].channel, tau),
            ls=dash,
            color="#5d646c",
            lw=1.5,
            label=f"{sheet.name}, data sheet",
        )
    upper.set_xscale("log")
    upper.set_yscale("log")
    upper.set_ylim(
        min(_lower_limit(result) for _, result in results),
        max(float(result.points.adev.max()) for _, result in results) * 1.5,
    )
    upper.set_ylabel(f"Allan deviation, {unit.si}")
    if unit_system() == "si":
        unit = replace(unit, common=unit.si, factor=1.0)
    right = upper.secondary_yaxis("right", functions=(_scale_by(unit.factor), _scale_by(1.0 / unit.factor)))
    right.set_ylabel(unit.common)
    add_legend_above(plot)
    # With y, matplotlib need not compute all ticks to place it; a logarithmic axis has no offset to avoid.
    upper.set_title(title, y=1.0)
    lower.axhline(0.0, color=_POINT_COLOUR, lw=0.8)
    lower.set_ylabel("residual, %")
    lower.set_xlabel("averaging time, s")
    for axes in (upper, lower):
        axes.grid(True, which="major", lw=0.4, color=_GRID_COLOUR)
    for axis in (upper.xaxis, upper.yaxis, right.yaxis):
        _use_plain_powers(axis)
    return plot


def _use_plain_powers(axis: Any) -> None:
    """Format powers of ten as plain text, because rendering formulae takes a third of a figure's time."""
    from matplotlib.ticker import LogFormatterSciNotation

    class Plain(LogFormatterSciNotation):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return _plain_powers(super().__call__(x, pos))

    axis.set_major_formatter(Plain())
    axis.set_minor_formatter(Plain(labelOnlyBase=False))


def _plain_powers(formula: str) -> str:
    r"""Return `10⁻³` for `$\mathdefault{10^{-3}}$`; text without exponent is unchanged."""
    text = formula.removeprefix(r"$\mathdefault{").removesuffix("}$").replace(r"\times", "×")
    return re.sub(r"\^\{(-?\d+)\}", lambda match: match[1].translate(_SUPERSCRIPTS), text)


def _points(axes: Any, result: AllanResult, label: str, colour: str, marker: str) -> None:
    points = result.points
    bars = [points.adev - result.low, result.high - points.adev]
    axes.fill_between(points.tau, result.low, result.high, color=colour, alpha=0.12, lw=0)
    axes.errorbar(points.tau, points.adev, bars, fmt=marker, ms=4, lw=1, color=colour, label=label)
    tau = _tau_range([result])
    axes.plot(tau, np.sqrt(result.fit.variance(tau)), color=colour, lw=1.3)


def _terms(axes: Any, result: AllanResult) -> None:
    """Plot the asymptotes of the significant terms, and the best averaging time."""
    tau = _tau_range([result])
    for column, name in zip(design_matrix(tau).T, TERMS, strict=True):
        term, unit = result.fit.terms[name], term_units(result.channel)[name]
        if term.value is not None:
            line = term.value * np.sqrt(column)
            shown = unit.shown()
            label = f"{name} = {term.value * shown.factor:.3g} {shown.name}"
            axes.plot(tau, line, "--", color=_TERM_COLOURS[name], lw=1, label=label)
            _mark_term(axes, name, term.value, tau)
    if result.best_tau is not None:
        axes.axvline(result.best_tau, color="#8a8d91", lw=0.8)


def _mark_term(axes: Any, name: str, value: float, tau: Array) -> None:
    """Write a term's letter at the averaging time of its value: N at 1 s, K at 3 s, B at its floor."""
    at, height = {
        "N": (1.0, value),
        "K": (3.0, value),
        "B": (float(np.sqrt(tau[0] * tau[-1])), value * math.sqrt(2.0 * math.log(2.0) / math.pi)),
    }.get(name, (0.0, 0.0))
    if tau[0] <= at <= tau[-1]:
        axes.plot([at], [height], "o", ms=7, mfc="none", mew=1.5, color=_TERM_COLOURS[name])
        axes.annotate(
            name, (at, height), (6, 6), textcoords="offset points", color=_TERM_COLOURS[name], weight="bold"
        )


def _residuals(axes: Any, result: AllanResult, colour: str, marker: str) -> None:
    """Plot the relative residuals in %; hollow markers for points that were not fitted."""
    points = result.points
    fitted = np.sqrt(result.fit.variance(points.tau))
    used = np.isin(points.factors, result.fit.factors)
    y, error = 100.0 * (points.adev / fitted - 1.0), 100.0 * result.sigma / fitted
    axes.errorbar(points.tau[used], y[used], error[used], fmt=marker, ms=4, lw=1, color=colour)
    axes.plot(points.tau[~used], y[~used], marker, ms=4, color=colour, mfc="none")
    limit = float(np.max(np.abs(y[used]) + error[used], initial=1.0))
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -limit), max(high, limit))


def _tau_range(results: Sequence[AllanResult]) -> Array:
    first = min(float(result.points.tau[0]) for result in results)
    last = max(float(result.points.tau[-1]) for result in results)
    return np.geomspace(first, last, 200)


def _scale_by(factor: float) -> Callable[[Any], Any]:
    """Return a function that multiplies by a factor, for an axis in another unit."""
    return lambda y: y * factor


def _lower_limit(result: AllanResult) -> float:
    """Return the lower limit of the figure: below all points and below the bias instability."""
    floor = math.sqrt(2.0 * math.log(2.0) / math.pi) * (result.fit.terms["B"].value or math.inf)
    return 0.7 * min(float(result.low.min()), floor)
