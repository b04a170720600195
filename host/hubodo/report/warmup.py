"""The warm-up of a gyro axis as words, tables and figures."""

from __future__ import annotations

import math

import numpy as np
import plotly.graph_objects as go

from hubodo.effects.warmup import PARAMETERS
from hubodo.report.page import Grid, Section, figure
from hubodo.sensors.warmup.characterise import WarmupReport
from hubodo.sensors.warmup.judge import Judged

_DEG = math.degrees(1.0)


def warmup_lead(report: WarmupReport) -> str:
    """The result in one sentence."""
    fit = report.first.fit
    white = "white" if report.first.white else "not white"
    if report.reason:
        return f"{report.reason[0].upper()}{report.reason[1:]}."
    return (
        f"The bias starts at {fit.values['c2'] * _DEG:+.4g} deg/s and changes by "
        f"{fit.values['c1'] * _DEG:+.4g} deg/s with a time "
        f"constant of {fit.values['time_constant'] / 60:.3g} min; the residual is {white}."
    )


def parameter_rows(judged: Judged) -> list[tuple[str, str, str]]:
    """Name, value with sigma in SI, and in degrees or minutes."""
    rows = []
    for name in PARAMETERS[judged.fit.kind]:
        value, sigma = judged.fit.values[name], judged.fit.sigma[name]
        if name.startswith("time_constant"):
            rows.append((name, f"{value:.5g} ± {sigma:.2g} s", f"{value / 60:.4g} ± {sigma / 60:.2g} min"))
        else:
            unit = ("rad/s/°C", "deg/s/°C") if name == "temperature_coefficient" else ("rad/s", "deg/s")
            rows.append(
                (
                    name,
                    f"{value:.5g} ± {sigma:.2g} {unit[0]}",
                    f"{value * _DEG:.4g} ± {sigma * _DEG:.2g} {unit[1]}",
                )
            )
    return rows


def whiteness_rows(judged: Judged) -> list[tuple[str, str, str]]:
    """Test, result, verdict."""
    a, box = judged.autocorrelation, judged.ljung_box
    return [
        (
            f"autocorrelation, {a.sequences} sequences of {a.length} samples",
            f"inside ±1 standard error {a.inside_one:.1%} (white: {a.expected_one:.1%}), ±2 "
            f"{a.inside_two:.1%} "
            f"(white: {a.expected_two:.1%}), p = {a.p_value:.2g}",
            "white" if a.white else "not white",
        ),
        (
            f"Ljung-Box, means over the whole record, {box.lags} lags",
            f"{box.statistic:.4g}, p = {box.p_value:.2g}",
            "white" if box.white else "not white",
        ),
    ]


def warmup_sections(report: WarmupReport) -> list[Section]:
    """Parameters, course, whiteness, for a page."""
    sections = [
        Section(
            "Warm-up",
            " ".join(f"{note}." for note in report.notes),
            [] if report.reason else [Grid(("parameter", "SI", "customary"), parameter_rows(report.first))],
            [_course(report)],
        ),
        Section(
            "Whiteness of the residual",
            "",
            [Grid(("test", "result", "verdict"), whiteness_rows(report.first))],
            [_lags(report)],
        ),
    ]
    if report.following is not None:
        tables = [
            Grid(("parameter", "SI", "customary"), parameter_rows(report.following)),
            Grid(("test", "result", "verdict"), whiteness_rows(report.following)),
        ]
        sections.append(Section(f"Next model: {report.following.fit.kind}", "", tables))
    return sections


def _course(report: WarmupReport) -> go.Figure:
    made = figure("time since power-on, min", "rate at rest, deg/s")
    made.add_scatter(
        x=report.t / 60,
        y=report.means * _DEG,
        mode="markers",
        name="means",
        marker={"size": 3, "color": "#8a8d91"},
    )
    for judged, colour in ((report.first, "#1b6ca8"), (report.following, "#d1495b")):
        if judged is not None:
            made.add_scatter(
                x=report.t / 60,
                y=(report.means - judged.fit.residual) * _DEG,
                mode="lines",
                name=judged.fit.kind,
                line={"color": colour},
            )
    return made


def _lags(report: WarmupReport) -> go.Figure:
    test = report.first.autocorrelation
    made = figure("lag, samples", "autocorrelation / R(0)", height=260)
    made.add_scatter(
        x=test.lags,
        y=test.autocorrelation,
        mode="lines",
        name="residual",
        line={"color": "#1b6ca8", "width": 1},
    )
    ends = np.array([test.lags[0], test.lags[-1]])
    for size in (-2, -1, 1, 2):
        made.add_scatter(
            x=ends,
            y=np.full(2, size * test.standard_error),
            mode="lines",
            showlegend=False,
            line={"color": "#8a8d91", "dash": "dot"},
        )
    return made
