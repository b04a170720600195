"""Summary, tables and recommendations for the warm-up of a gyro axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hubodo.effects.warmup import TEMPERATURE_PARAMETERS, WARMUP_PARAMETERS
from hubodo.pages.drawing import render_drawing
from hubodo.pages.page import PageTable, Section
from hubodo.sensors.warmup.assess import AssessedFit
from hubodo.sensors.warmup.figure import temperature_figure, warmup_figure
from hubodo.sensors.warmup.profile_interval import describe_intervals
from hubodo.unit_systems import RATE, RATE_SAMPLE, ShownUnit, without_other_units

if TYPE_CHECKING:
    from hubodo.sensors.warmup.result import WarmupResult

_MIN_SHOWN_SPAN = 1.0  # °C
_PER_DEGREE = dict(zip(TEMPERATURE_PARAMETERS, ("/°C", "/°C²", "/°C³"), strict=True))
TEST_HEADINGS = ("test", "result", "verdict")


def summarise_warmup(result: WarmupResult) -> str:
    """Return the result in one sentence."""
    if result.accepted is None:
        return (
            f"{result.reason[0].upper()}{result.reason[1:]}. As an exponential: "
            f"{describe_intervals(result.intervals)}."
        )
    fit = result.accepted.fit
    white = "white" if result.accepted.is_white else "not white"
    unit = _bias_unit()
    text = f"The bias starts at {unit.number(fit.values['c2'], '+.4g')} {unit.name}"
    if "temperature_coefficient" in fit.values:
        text = (
            f"The bias is {unit.number(fit.values['c2'], '+.4g')} {unit.name} at 25 °C, follows the "
            f"temperature by {unit.number(fit.values['temperature_coefficient'], '+.3g')} {unit.name}/°C"
        )
    for which, word in (("", "changes"), ("_second", "also")):
        if f"c1{which}" in fit.values:
            change = unit.number(fit.values[f"c1{which}"], "+.4g")
            text += (
                f" and {word} by {change} {unit.name} with a time constant of "
                f"{fit.values[f'time_constant{which}'] / 60:.3g} min"
            )
    return f"{text}; the residual is {white}."


def _bias_unit() -> ShownUnit:
    return RATE.shown(RATE_SAMPLE)


def parameter_headings() -> tuple[str, ...]:
    """Return the headings of `parameter_rows`."""
    return without_other_units([("parameter", "SI", "common unit")], si=1, common=2)[0]


def parameter_rows(assessed: AssessedFit, sigmas: Mapping[str, float] | None = None) -> list[tuple[str, ...]]:
    """Return rows of parameter, value with sigma in SI, and the same in degrees or minutes.

    sigmas: standard deviations that replace the fit's own.
    """
    rows, common = [], _bias_unit()
    for name in WARMUP_PARAMETERS[assessed.fit.kind]:
        value, sigma = assessed.fit.values[name], (sigmas or assessed.fit.sigma)[name]
        if name.startswith("time_constant"):
            rows.append((name, f"{value:.5g} ± {sigma:.2g} s", f"{value / 60:.4g} ± {sigma / 60:.2g} min"))
        else:
            per = _PER_DEGREE.get(name, "")
            rows.append(
                (
                    name,
                    f"{value:.5g} ± {sigma:.2g} rad/s{per}",
                    f"{value * common.factor:.4g} ± {sigma * common.factor:.2g} {common.name}{per}",
                )
            )
    return without_other_units(rows, si=1, common=2)


def whiteness_rows(assessed: AssessedFit) -> list[tuple[str, str, str]]:
    """Return rows of test, result and verdict."""
    autocorrelation, ljung_box = assessed.autocorrelation, assessed.ljung_box
    return [
        (
            f"autocorrelation, {autocorrelation.sequences} sequences of {autocorrelation.length} samples",
            f"within ±1 standard error {autocorrelation.share_within_one_sigma:.1%} "
            f"(white noise: {autocorrelation.expected_share_within_one_sigma:.1%}), within ±2 "
            f"{autocorrelation.share_within_two_sigma:.1%} "
            f"(white noise: {autocorrelation.expected_share_within_two_sigma:.1%}), p = "
            f"{autocorrelation.p_value:.2g}",
            "white" if autocorrelation.is_white else "not white",
        ),
        (
            f"Ljung-Box, means over the whole record, {ljung_box.lags} lags",
            f"{ljung_box.statistic:.4g}, p = {ljung_box.p_value:.2g}",
            "white" if ljung_box.is_white else "not white",
        ),
    ]


def forecast_headings() -> tuple[str, str, str]:
    """Return the headings of `forecast_rows`."""
    unit = _bias_unit().name
    return ("since power-on", f"all models, {unit}", f"accepted model, {unit}")


def forecast_rows(result: WarmupResult, ages: Sequence[float] = ()) -> list[tuple[str, str, str]]:
    """Return rows of age, forecast over all forms with sigma, and accepted model with its rms error."""
    rows, unit = [], _bias_unit()

    def cell(bias: float, sigma: float) -> str:
        return f"{unit.number(bias, '+.4f')} ± {unit.number(sigma, '.4f')}"

    for row in result.predict(ages):
        accepted = "-" if "accepted" not in row else cell(row["accepted"], row["accepted_sigma"])
        bias = cell(row["bias"], row["sigma"])
        rows.append((f"{row['age'] / 60.0:.1f} min", bias, accepted))
    return rows


def warmup_advice(result: WarmupResult) -> list[str]:
    """Return recommendations, one line each."""
    method, unit = result.bias_method, RATE.shown()
    if method is None:
        return _advice(result)
    errors = ", ".join(f"{name} {unit.number(value, '.3g')}" for name, value in method.errors.items())
    return [*_advice(result), f"After a standstill: {method.why} (held-out error, {unit.name}: {errors})."]


def _advice(result: WarmupResult) -> list[str]:
    span = float(result.t[-1] - result.t[0])
    if result.accepted is None:
        return [
            "Do not write a calibration: correcting a warm-up that does not exist adds a drift.",
            "Keep the node stationary for ten seconds before each drive and subtract that mean; at stops "
            "too.",
            "To measure a warm-up, record from a cold start, several times as long as these "
            f"{span / 60.0:.3g} min.",
        ]
    end = result.predict([float(result.t[-1]) + 3600.0])[0]
    lines = [
        f"hubodo warmup LOG --node {result.node} --channel {result.channel} -o calibration.toml writes the "
        f"{result.accepted.fit.kind}; hubodo fuse, record, heading and flash use that file.",
        "Still start with a standstill: the turn-on bias varies, the warm-up after it far less.",
        "One hour beyond this record the error of the model is "
        f"{RATE.shown().number(end['accepted_sigma'], '.2g')} {RATE.shown().name} (1σ).",
    ]
    if not result.accepted.ljung_box.is_white:
        lines.append("The residual is not white: hubodo allan shows the bias instability and random walk.")
    return lines


def _describe_forecast(result: WarmupResult) -> str:
    if result.form is not None:
        return f"Of the stated form, {result.form}, with the slow noise of the bias that the record shows."
    return (
        "Averaged over one exponential, two, and mixtures of many, each weighted by its evidence in the "
        "record; includes flicker and random walk of the bias."
    )


def _temperature_sections(result: WarmupResult) -> list[Section]:
    """Return the section with the rate against the temperature, if the record has one that changes."""
    if result.mean_temperatures is None or float(np.ptp(result.mean_temperatures)) < _MIN_SHOWN_SPAN:
        return []
    text = "Blue while the temperature rises, red while it falls."
    figure = render_drawing(lambda: temperature_figure(result))
    return [Section("Rate against temperature", text, figures=[figure])]


def warmup_sections(result: WarmupResult) -> list[Section]:
    """Return the sections of a page: recommendations, parameters, figure, forecast and whiteness."""
    tables = []
    if result.accepted is not None:
        tables.append(PageTable(parameter_headings(), parameter_rows(result.accepted, result.sigma)))
    notes = " ".join(f"{note}." for note in result.remarks)
    if result.accepted is not None:
        notes += (
            f" Accepted model: {result.accepted.fit.kind}; its sigmas include the uncertainty of its form."
        )
    tests = [PageTable(TEST_HEADINGS, whiteness_rows(result.exponential))]
    sections = [
        Section("What to do", advice=warmup_advice(result)),
        Section("Warm-up", notes, tables, [render_drawing(lambda: warmup_figure(result, ""))]),
        Section(
            "Forecast of the bias",
            _describe_forecast(result),
            [PageTable(forecast_headings(), forecast_rows(result))],
        ),
        *_temperature_sections(result),
        Section("Whiteness of the residual of the exponential", tables=tests),
    ]
    if result.next_model is not None:
        tables = [
            PageTable(parameter_headings(), parameter_rows(result.next_model)),
            PageTable(TEST_HEADINGS, whiteness_rows(result.next_model)),
        ]
        sections.append(Section(f"Next model: {result.next_model.fit.kind}", "", tables))
    return sections
