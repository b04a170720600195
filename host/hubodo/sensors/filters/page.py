"""Summary, tables, recommendation and figures of a comparison of filters."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from hubodo.arrays import Array
from hubodo.pages.drawing import add_legend_above, new_figure, render_drawing
from hubodo.pages.page import PageTable, Section
from hubodo.unit_systems import RATE, RATE_SAMPLE, unit_system

if TYPE_CHECKING:
    from hubodo.sensors.filters.result import FilterComparison, FilterScore

_COLOURS = ("#8a8d91", "#b0793b", "#1b6ca8", "#e3a5ac", "#7d3c98", "#d1495b", "#2e7d5b")
"""One colour for each filter, raw first."""
_DETAIL_S = 6.0
"""Length of the detail of the rate, s: some changes of speed of a wheel."""
_MAX_LAGS = 100
_MAX_POINTS = 4000
_HISTOGRAM_BINS = 60


def summarise_comparison(result: FilterComparison) -> str:
    """Return the best filter and its error in one sentence."""
    scores, unit = result.scores, RATE_SAMPLE.shown()
    best = min(scores, key=lambda it: it.error)
    criterion = "against " + result.reference.name if result.reference else "predicting the next sample"
    error, raw = (f"{unit.number(it.error, '.3g')} {unit.name}" for it in (best, scores[0]))
    return f"Smallest error in the second half: {best.candidate.name}, {error} rms {criterion} (raw {raw})."


def score_headings(result: FilterComparison) -> tuple[str, ...]:
    """Return the headings of `score_rows`."""
    error = "rms error" if result.reference else "prediction error"
    unit = RATE_SAMPLE.shown().name
    both = () if unit_system() else ("rad/s",)
    return ("filter", f"{error}, held out, {unit}", *both, f"first half, {unit}", "delay, ms", "run time, µs")


def score_rows(result: FilterComparison) -> list[tuple[str, ...]]:
    """Return one row for each filter."""
    unit = RATE_SAMPLE.shown()
    return [
        (
            _label(score),
            unit.number(score.error, ".4g"),
            *(() if unit_system() else (f"{score.error:.3g}",)),
            unit.number(score.tuning_error, ".4g"),
            "-" if score.delay is None else f"{score.delay * 1e3:z.1f}",
            f"{score.run_time * 1e6:.2f}",
        )
        for score in result.scores
    ]


def _label(score: FilterScore) -> str:
    """Return name and constants of a filter."""
    constants = score.candidate.constants
    if score.candidate.kind == "moving average":
        return f"moving average of {constants['width_samples']:.0f} samples"
    if score.candidate.kind == "Kalman":
        return f"Kalman (k₁ {constants['rate_gain']:.3g}, k₂ {constants['bias_gain']:.2g} per sample)"
    if score.candidate.kind == "six-state":
        unit = RATE_SAMPLE.shown(si_by_default=True)
        derivative = unit.number(constants["highest_derivative"], ".2g")
        return f"six-state (σ of third derivative {derivative} {unit.name}/s²)"
    return score.candidate.name


def bias_headings() -> tuple[str, ...]:
    """Return the headings of `bias_rows`."""
    bias, sigma = RATE.shown(RATE_SAMPLE).name, RATE.shown().name
    return ("method", f"bias, {bias}", f"1σ, {sigma}", f"other standstill samples, {sigma}")


def bias_rows(result: FilterComparison) -> list[tuple[str, ...]]:
    """Return one row for each method of static bias."""
    bias, sigma = RATE.shown(RATE_SAMPLE), RATE.shown()
    return [
        (
            it.method,
            bias.number(it.bias, "+.5f"),
            sigma.number(it.sigma, ".3g"),
            "-" if it.held_out is None else sigma.number(it.held_out, "+.3g"),
        )
        for it in result.biases
    ]


def recommend_filter(result: FilterComparison) -> str:
    """Return the filter to set on the node with the command to paste."""
    chosen = result.chosen
    if chosen is None:
        return "No filter is recommended from a record without motion."
    settings = " ".join(f"--set {name}={value}" for name, value in (result.settings or {}).items())
    command = f"hubodo flash PORT {settings}"
    if chosen.candidate.kind == "raw":
        return f"Send raw samples: no filter of the node is significantly better ({command})."
    best = min(result.scores, key=lambda it: it.error)
    others = ""
    if best.candidate.settings is None:
        others = f"; {best.candidate.name} has the smallest error, but the node does not have it"
    return f"On the node use {chosen.candidate.name}, at {1.0 / result.dt:.4g} Hz: {command}{others}."


def filter_sections(result: FilterComparison) -> list[Section]:
    """Return the sections of a page: errors, rate, bias, and autocorrelation."""
    sections = [
        Section(
            "Errors",
            "Constants are chosen in the first half of the record, errors are those of the second half.",
            [PageTable(score_headings(result), score_rows(result))],
            advice=[result.recommendation, *result.notes],
        ),
        _figure_section("Rate", "Estimates around the largest change of the rate.", result, _plot_rate),
        _figure_section("Error", "Moving rms over one second.", result, _plot_error),
    ]
    if result.biases:
        bias = _figure_section(
            "Bias",
            "Samples at standstill before and after the bias is subtracted; it is estimated from the first "
            "half of them.",
            result,
            _plot_histogram,
        )
        table = PageTable(bias_headings(), bias_rows(result))
        sections.append(Section(bias.title, bias.text, [table], bias.figures))
    sections.append(
        _figure_section(
            "Autocorrelation of the error",
            "White errors stay within the dashed lines (two standard errors).",
            result,
            _plot_autocorrelation,
        )
    )
    return sections


def filter_figure(result: FilterComparison, title: str) -> Any:
    """Return a matplotlib figure of rate, error, bias histogram and autocorrelation."""
    figure = new_figure(9.0, 10.0)
    axes = figure.subplots(4, 1)
    for one, plot in zip(
        axes, (_plot_rate, _plot_error, _plot_histogram, _plot_autocorrelation), strict=True
    ):
        plot(one, result)
        one.grid(True, lw=0.3, color="#d8dce0")
    axes[0].set_title(title)
    return figure


def _figure_section(
    title: str, text: str, result: FilterComparison, plot: Callable[[Any, FilterComparison], None]
) -> Section:
    def draw() -> Any:
        figure = new_figure(9.0, 3.4)
        axes = figure.subplots()
        plot(axes, result)
        axes.grid(True, lw=0.3, color="#d8dce0")
        return figure

    return Section(title, text, figures=[render_drawing(draw)])


def _plot_rate(axes: Any, result: FilterComparison) -> None:
    width = min(len(result.t), max(50, round(_DETAIL_S / result.dt)))
    starts = range(0, len(result.t) - width + 1, max(1, width // 4))
    first = max(starts, key=lambda k: float(np.ptp(result.samples[k : k + width])))
    part, unit = slice(first, first + width), RATE_SAMPLE.shown()
    for score, colour in zip(result.scores, _COLOURS, strict=True):
        is_raw = score.candidate.kind == "raw"
        axes.plot(
            result.t[part],
            score.rates[part] * unit.factor,
            color=colour,
            lw=0.6 if is_raw else 1.0,
            label=score.candidate.name,
        )
    if result.truth is not None:
        axes.plot(result.t[part], result.truth[part] * unit.factor, "k--", lw=0.8, label="reference")
    axes.set_xlabel("t, s")
    axes.set_ylabel(f"rate, {unit.name}")
    add_legend_above(axes.figure)


def _plot_error(axes: Any, result: FilterComparison) -> None:
    width, unit = max(1, round(1.0 / result.dt)), RATE_SAMPLE.shown()
    for score, colour in zip(result.scores, _COLOURS, strict=True):
        squares = np.nan_to_num(score.errors**2)
        count = len(squares) // width
        rms = np.sqrt(squares[: count * width].reshape(count, width).mean(axis=1))
        stride = max(1, count // _MAX_POINTS)
        axes.plot(
            result.t[: count * width : width][::stride],
            rms[::stride] * unit.factor,
            color=colour,
            lw=0.8,
            label=score.candidate.name,
        )
    axes.axvline(result.t[len(result.t) // 2], color="#8a8d91", lw=0.8, ls=":")
    axes.set_yscale("log")
    axes.set_xlabel("t, s")
    axes.set_ylabel(f"rms error, {unit.name}")
    add_legend_above(axes.figure)


def _plot_histogram(axes: Any, result: FilterComparison) -> None:
    unit = RATE_SAMPLE.shown()
    axes.set_xlabel(f"samples at standstill, {unit.name}")
    axes.set_ylabel("count")
    if not len(result.standstill_samples):
        return
    samples = result.standstill_samples * unit.factor
    bias = result.initial.bias * unit.factor
    edges = np.linspace(samples.min(), samples.max(), _HISTOGRAM_BINS + 1)
    if edges[-1] > edges[0]:
        counts = np.histogram(samples, edges)[0]
        axes.stairs(counts, edges, fill=True, alpha=0.6, color="#8a8d91", label="before")
        axes.stairs(counts, edges - bias, fill=True, alpha=0.6, color="#1b6ca8", label="bias subtracted")
    axes.axvline(0.0, color="black", lw=0.8)
    add_legend_above(axes.figure)


def _plot_autocorrelation(axes: Any, result: FilterComparison) -> None:
    for score, colour in zip(result.scores, _COLOURS, strict=True):
        values = score.errors[len(result.t) // 2 :]
        lags = autocorrelation(values[np.isfinite(values)], _MAX_LAGS)
        axes.plot(np.arange(len(lags)) * result.dt, lags, color=colour, lw=0.9, label=score.candidate.name)
    bound = 2.0 / math.sqrt(max(1, len(result.t) // 2))
    for level in (-bound, bound):
        axes.axhline(level, color="black", lw=0.6, ls="--")
    axes.set_xlabel("lag, s")
    axes.set_ylabel("autocorrelation")
    add_legend_above(axes.figure)


def autocorrelation(values: Array, lags: int) -> Array:
    """Return the autocorrelation of (N,) values at lags 0 to `lags`, at most N - 1, relative to lag 0."""
    centred = values - values.mean()
    power = float(centred @ centred)
    count = min(lags + 1, len(centred))
    if not power:
        return np.zeros(count)
    return np.array([float(centred[k:] @ centred[: len(centred) - k]) / power for k in range(count)])
