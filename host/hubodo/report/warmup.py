"""Summary, tables and recommendations for the warm-up of a gyro axis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from hubodo.effects.warmup import WARMUP_PARAMETERS
from hubodo.report.drawing import render_drawing
from hubodo.report.page import PageTable, Section
from hubodo.report.warmup_figure import warmup_figure
from hubodo.sensors.warmup.assess import AssessedFit
from hubodo.sensors.warmup.result import WarmupAnalysis

_DEG = math.degrees(1.0)


def summarise_warmup(report: WarmupAnalysis) -> str:
    """Return the result in one sentence."""
    if report.accepted is None:
        return f"{report.reason[0].upper()}{report.reason[1:]}."
    fit = report.accepted.fit
    white = "white" if report.accepted.is_white else "not white"
    made = f"The bias starts at {fit.values['c2'] * _DEG:+.4g} deg/s"
    if "temperature_coefficient" in fit.values:
        made = (
            f"The bias is {fit.values['c2'] * _DEG:+.4g} deg/s at 25 °C, follows the temperature by "
            f"{fit.values['temperature_coefficient'] * _DEG:+.3g} deg/s/°C"
        )
    for which, word in (("", "changes"), ("_second", "also")):
        if f"c1{which}" in fit.values:
            made += (
                f" and {word} by {fit.values[f'c1{which}'] * _DEG:+.4g} deg/s with a time constant of "
                f"{fit.values[f'time_constant{which}'] / 60:.3g} min"
            )
    return f"{made}; the residual is {white}."


def parameter_rows(
    judged: AssessedFit, sigmas: Mapping[str, float] | None = None
) -> list[tuple[str, str, str]]:
    """Return name, value with sigma in SI, and in degrees or minutes; sigmas: replace those of the fit."""
    rows = []
    for name in WARMUP_PARAMETERS[judged.fit.kind]:
        value, sigma = judged.fit.values[name], (sigmas or judged.fit.sigma)[name]
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


def whiteness_rows(judged: AssessedFit) -> list[tuple[str, str, str]]:
    """Return rows of test, result and verdict."""
    a, box = judged.autocorrelation, judged.ljung_box
    return [
        (
            f"autocorrelation, {a.sequences} sequences of {a.length} samples",
            f"within ±1 standard error {a.share_within_one_sigma:.1%} "
            f"(white noise: {a.expected_share_within_one_sigma:.1%}), within ±2 {a.share_within_two_sigma:.1%} "
            f"(white noise: {a.expected_share_within_two_sigma:.1%}), p = {a.p_value:.2g}",
            "white" if a.is_white else "not white",
        ),
        (
            f"Ljung-Box, means over the whole record, {box.lags} lags",
            f"{box.statistic:.4g}, p = {box.p_value:.2g}",
            "white" if box.is_white else "not white",
        ),
    ]


def forecast_rows(report: WarmupAnalysis, ages: Sequence[float] = ()) -> list[tuple[str, str, str]]:
    """Return rows of age, forecast over all forms with sigma, and accepted model with its rms error."""
    rows = []
    for row in report.predict(ages):
        accepted = "-"
        if "accepted" in row:
            accepted = f"{row['accepted'] * _DEG:+.4f} ± {row['accepted_sigma'] * _DEG:.4f}"
        bias = f"{row['bias'] * _DEG:+.4f} ± {row['sigma'] * _DEG:.4f}"
        rows.append((f"{row['age'] / 60.0:.1f} min", bias, accepted))
    return rows


def warmup_advice(report: WarmupAnalysis, node: str) -> list[str]:
    """Return recommendations, one line each."""
    choice = [] if report.bias_method is None else [f"After a standstill: {report.bias_method.why}."]
    return [*_advice(report, node), *choice]


def _advice(report: WarmupAnalysis, node: str) -> list[str]:
    span = float(report.t[-1] - report.t[0])
    if report.accepted is None:
        return [
            "Do not write a calibration: correcting a warm-up that does not exist adds a drift.",
            "Keep the node stationary for ten seconds before each drive and subtract that mean; at stops too.",
            f"To measure a warm-up, record from a cold start, several times as long as these {span / 60.0:.3g} min.",
        ]
    end = report.predict([float(report.t[-1]) + 3600.0])[0]
    lines = [
        f"hubodo warmup LOG --node {node} --channel {report.channel} -o calibration.toml writes the "
        f"{report.accepted.fit.kind}; hubodo fuse, record, heading and flash use that file.",
        "Still start with a standstill: the turn-on bias varies, the warm-up after it far less.",
        f"One hour beyond this record the error of the model is {end['accepted_sigma'] * _DEG * 3600.0:.2g} °/h "
        "(1σ).",
    ]
    if not report.accepted.ljung_box.is_white:
        lines.append("The residual is not white: hubodo allan shows the bias instability and random walk.")
    return lines


def warmup_sections(report: WarmupAnalysis, node: str) -> list[Section]:
    """Return the sections of a page: recommendations, parameters, figure, forecast and whiteness."""
    heads = ("parameter", "SI", "common unit")
    tables = []
    if report.accepted is not None:
        tables.append(PageTable(heads, parameter_rows(report.accepted, report.sigma)))
    notes = " ".join(f"{note}." for note in report.notes)
    if report.accepted is not None:
        notes += (
            f" Accepted model: {report.accepted.fit.kind}; its sigmas include the uncertainty of its form."
        )
    tests = [PageTable(("test", "result", "verdict"), whiteness_rows(report.exponential))]
    sections = [
        Section("What to do", advice=warmup_advice(report, node)),
        Section("Warm-up", notes, tables, [render_drawing(lambda: warmup_figure(report, ""))]),
        Section(
            "Forecast of the bias",
            "Averaged over one exponential, two, and mixtures of many, each weighted by its evidence in the "
            "record; includes flicker and random walk of the bias.",
            [
                PageTable(
                    ("since power-on", "all forms, deg/s", "accepted model, deg/s"), forecast_rows(report)
                )
            ],
        ),
        Section("Whiteness of the residual of the exponential", tables=tests),
    ]
    if report.next_model is not None:
        tables = [
            PageTable(heads, parameter_rows(report.next_model)),
            PageTable(("test", "result", "verdict"), whiteness_rows(report.next_model)),
        ]
        sections.append(Section(f"Next model: {report.next_model.fit.kind}", "", tables))
    return sections
