"""The Allan deviation of a channel as words, tables, an interactive figure and a PNG."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from hubodo.report.page import Grid, Section, figure
from hubodo.report.png import blank
from hubodo.sensors.allan.characterise import AllanReport
from hubodo.sensors.allan.covariance import TERMS, design
from hubodo.sensors.allan.ieee952 import is_gyro, rate_unit, units

FloatArray = NDArray[np.float64]

MEANING = {
    "Q": "steps of the converter; gone after a fraction of a second",
    "N": "white noise: the mean over a time t is this / √t off, the integral this · √t",
    "B": "the floor: averaging for longer does not get below about 0.664 of it",
    "K": "the bias walks: after a time t without looking it is this · √t elsewhere",
    "R": "the bias drifts along a line",
}

_LINES = {"Q": "#8a6d3b", "N": "#1b6ca8", "B": "#2e7d5b", "K": "#d1495b", "R": "#7a4fa3"}
_SLOPES = {"Q": "slope −1", "N": "slope −1/2", "B": "slope 0", "K": "slope +1/2", "R": "slope +1"}


def value_words(value: float, unit: str) -> str:
    """Four digits and the unit."""
    return f"{value:.4g} {unit}"


def duration_words(seconds: float) -> str:
    """A time in the unit a person would use."""
    for size, name in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.3g} s"


def allan_lead(report: AllanReport) -> str:
    """The result in one or two sentences."""
    unit = rate_unit(report.channel)
    if report.best_tau is None or report.best_deviation is None:
        best = "The record is too short to show the best averaging time."
    else:
        best = (
            f"Averaging pays up to {duration_words(report.best_tau)}; what remains then is "
            f"{value_words(report.best_deviation * unit.factor, unit.customary)} "
            f"({value_words(report.best_deviation, unit.si)})."
        )
    if report.stop is not None and is_gyro(report.channel):
        best += f" For maytagging, stops of {duration_words(report.stop)} (turns of {report.turn:g} s)."
    return best


def allan_sections(report: AllanReport) -> list[Section]:
    """Terms, figure and an account of the record, for a page."""
    names = units(report.channel)
    rows, missing = [], []
    for name, unit in names.items():
        term = report.fit.terms[name]
        if term.value is None or term.sigma is None:
            limit = "" if term.limit is None else value_words(term.limit, unit.si)
            needed = "" if term.needed is None else duration_words(term.needed)
            missing.append((f"{name} {unit.name}", limit, needed, term.reason))
        else:
            rows.append(
                (
                    f"{name} {unit.name}",
                    f"{term.value:.4g} ± {term.sigma:.2g} {unit.si}",
                    value_words(term.value * unit.factor, unit.customary),
                    MEANING[name],
                )
            )
    record = report.record
    account = [
        ("samples", f"{int(np.count_nonzero(record.present))} of {len(record.values)}"),
        ("interval", f"{record.dt:.8g} s"),
        ("duration", duration_words(record.duration)),
        ("gaps", str(len(record.gaps))),
        ("outliers", str(len(record.outliers))),
        ("fit", f"chi-square {report.fit.chi2:.4g} for {report.fit.dof} degrees of freedom"),
    ]
    return [
        Section(
            "Noise terms", "IEEE 952 names; 1 sigma.", [Grid(("term", "SI", "customary", "meaning"), rows)]
        ),
        Section(
            "Allan deviation",
            "Points with 95 % intervals; the line is the sum of the terms, dashed are their asymptotes.",
            figures=[_figure(report)],
        ),
        *(
            [
                Section(
                    "What this record cannot show",
                    "",
                    [Grid(("term", "below (95 %)", "record needed", "why"), missing)],
                )
            ]
            if missing
            else []
        ),
        Section("The record", " ".join(f"{note}." for note in report.notes), [Grid(("", ""), account)]),
    ]


def _figure(report: AllanReport) -> go.Figure:
    unit = rate_unit(report.channel)
    made = figure("averaging time, s", f"Allan deviation, {unit.si}", height=460)
    points = report.points
    made.add_scatter(
        x=points.tau,
        y=points.adev,
        error_y={
            "type": "data",
            "symmetric": False,
            "array": report.high - points.adev,
            "arrayminus": points.adev - report.low,
        },
        mode="markers",
        name="measured",
        marker={"color": "#1d2126", "size": 6},
    )
    tau = np.geomspace(points.tau[0], points.tau[-1], 200)
    made.add_scatter(
        x=tau, y=_fitted(report, tau), mode="lines", name="fit", line={"color": "#1d2126", "width": 1.5}
    )
    for name, line in _asymptotes(report, tau).items():
        made.add_scatter(
            x=tau,
            y=line,
            mode="lines",
            name=f"{name}, {_SLOPES[name]}",
            line={"color": _LINES[name], "dash": "dash", "width": 1},
        )
    low, high = _bottom(report), float(points.adev.max()) * 1.5
    made.update_xaxes(type="log", dtick=1)
    made.update_yaxes(type="log", dtick=1, range=[math.log10(low), math.log10(high)])
    return made


def allan_png(report: AllanReport, path: Path, title: str) -> None:
    """The same figure as a PNG. Raises OSError when the file cannot be written."""
    unit = rate_unit(report.channel)
    points = report.points
    made = blank(8.0, 5.5)
    axes = made.add_subplot()
    axes.errorbar(
        points.tau,
        points.adev,
        [points.adev - report.low, report.high - points.adev],
        fmt="o",
        ms=4,
        lw=1,
        color="#1d2126",
        label="measured, 95 %",
    )
    tau = np.geomspace(points.tau[0], points.tau[-1], 200)
    axes.plot(tau, _fitted(report, tau), color="#1d2126", lw=1.3, label="fit")
    for name, line in _asymptotes(report, tau).items():
        term = report.fit.terms[name]
        unit_of = units(report.channel)[name]
        value = 0.0 if term.value is None else term.value * unit_of.factor
        axes.plot(
            tau, line, "--", color=_LINES[name], lw=1, label=f"{name} = {value:.3g} {unit_of.customary}"
        )
    if report.best_tau is not None:
        axes.axvline(report.best_tau, color="#8a8d91", lw=0.8)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(_bottom(report), float(points.adev.max()) * 1.5)
    axes.set_xlabel("averaging time, s")
    axes.set_ylabel(f"Allan deviation, {unit.si}")
    right = axes.secondary_yaxis("right", functions=(_scaled(unit.factor), _scaled(1.0 / unit.factor)))
    right.set_ylabel(unit.customary)
    axes.grid(True, which="both", lw=0.3, color="#d8dce0")
    axes.legend(fontsize=8)
    axes.set_title(title)
    made.savefig(path, dpi=150, format="png")


def _fitted(report: AllanReport, tau: FloatArray) -> FloatArray:
    made: FloatArray = np.sqrt(report.fit.variance(tau))
    return made


def _scaled(factor: float) -> Callable[[Any], Any]:
    """Multiplication by a factor, for the second axis."""
    return lambda y: y * factor


def _bottom(report: AllanReport) -> float:
    """Lower end of the figure: below the points, and below the floor where one is shown."""
    floor = math.sqrt(2.0 * math.log(2.0) / math.pi) * (report.fit.terms["B"].value or math.inf)
    return 0.7 * min(float(report.low.min()), floor)


def _asymptotes(report: AllanReport, tau: FloatArray) -> dict[str, FloatArray]:
    """Each term alone, where it is shown."""
    columns = design(tau)
    return {
        name: np.sqrt(columns[:, k] * report.fit.theta[k])
        for k, name in enumerate(TERMS)
        if report.fit.terms[name].value is not None
    }
