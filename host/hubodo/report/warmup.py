"""The warm-up of a gyro axis as words and tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from hubodo.effects.warmup import WARMUP_PARAMETERS
from hubodo.report.drawing import drawing
from hubodo.report.page import Grid, Section
from hubodo.report.warmup_figure import warmup_figure
from hubodo.sensors.warmup.assess import AssessedFit
from hubodo.sensors.warmup.result import WarmupReport

_DEG = math.degrees(1.0)


def warmup_lead(report: WarmupReport) -> str:
    """The result in one sentence."""
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
    """Name, value with sigma in SI, and in degrees or minutes; sigmas: in place of those of the fit."""
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
    """Test, result, verdict."""
    a, box = judged.autocorrelation, judged.ljung_box
    return [
        (
            f"autocorrelation, {a.sequences} sequences of {a.length} samples",
            f"inside ±1 standard error {a.share_within_one_sigma:.1%} "
            f"(white: {a.expected_share_within_one_sigma:.1%}), ±2 "
            f"{a.share_within_two_sigma:.1%} "
            f"(white: {a.expected_share_within_two_sigma:.1%}), p = {a.p_value:.2g}",
            "white" if a.is_white else "not white",
        ),
        (
            f"Ljung-Box, means over the whole record, {box.lags} lags",
            f"{box.statistic:.4g}, p = {box.p_value:.2g}",
            "white" if box.is_white else "not white",
        ),
    ]


def prediction_rows(report: WarmupReport, ages: Sequence[float] = ()) -> list[tuple[str, str, str]]:
    """Age, forecast over all forms with its sigma, and the accepted model with what it may be off by."""
    rows = []
    for row in report.predict(ages):
        accepted = "-"
        if "accepted" in row:
            accepted = f"{row['accepted'] * _DEG:+.4f} ± {row['accepted_sigma'] * _DEG:.4f}"
        bias = f"{row['bias'] * _DEG:+.4f} ± {row['sigma'] * _DEG:.4f}"
        rows.append((f"{row['age'] / 60.0:.1f} min", bias, accepted))
    return rows


def advice(report: WarmupReport, node: str) -> list[str]:
    """What to do with the result, line by line."""
    choice = [] if report.bias_method is None else [f"After a rest: {report.bias_method.why}."]
    return [*_advice(report, node), *choice]


def _advice(report: WarmupReport, node: str) -> list[str]:
    span = float(report.t[-1] - report.t[0])
    if report.accepted is None:
        return [
            "Write nothing: a filter that takes off a warm-up which is not there adds a drift.",
            "Let the node stand for ten seconds before each drive and subtract that mean, at halts too.",
            f"For a warm-up, record from a cold start, several times as long as these {span / 60.0:.3g} min.",
        ]
    end = report.predict([float(report.t[-1]) + 3600.0])[0]
    lines = [
        f"hubodo warmup LOG --node {node} --channel {report.channel} -o calibration.toml writes the "
        f"{report.accepted.fit.kind}; hubodo fuse, record, heading and flash take it from there.",
        "Still begin with a rest: the offset changes from one power-on to the next, its course far less.",
        f"An hour beyond this record the model is off by {end['accepted_sigma'] * _DEG * 3600.0:.2g} °/h, "
        "1 sigma.",
    ]
    if not report.accepted.ljung_box.is_white:
        lines.append("The residual is not white: hubodo allan tells how far the bias wanders by itself.")
    return lines


def warmup_sections(report: WarmupReport, node: str) -> list[Section]:
    """Parameters, course, forecast, whiteness, what to do, for a page."""
    heads = ("parameter", "SI", "customary")
    tables = []
    if report.accepted is not None:
        tables.append(Grid(heads, parameter_rows(report.accepted, report.sigma)))
    notes = " ".join(f"{note}." for note in report.notes)
    if report.accepted is not None:
        notes += (
            f" The accepted model: {report.accepted.fit.kind}; its sigmas count that its form may be another."
        )
    tests = [Grid(("test", "result", "verdict"), whiteness_rows(report.exponential))]
    sections = [
        Section("What to do", advice=advice(report, node)),
        Section("Warm-up", notes, tables, [drawing(lambda: warmup_figure(report, ""))]),
        Section(
            "The bias at other times",
            "Over one exponential, two, and any mixture of them, each weighted by how well it explains the "
            "record; flicker and random walk go on.",
            [Grid(("since power-on", "all forms, deg/s", "accepted model, deg/s"), prediction_rows(report))],
        ),
        Section("Whiteness of the residual of the exponential", tables=tests),
    ]
    if report.next_model is not None:
        tables = [
            Grid(heads, parameter_rows(report.next_model)),
            Grid(("test", "result", "verdict"), whiteness_rows(report.next_model)),
        ]
        sections.append(Section(f"Next model: {report.next_model.fit.kind}", "", tables))
    return sections
