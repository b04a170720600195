"""Summary, tables and figures of the heading of one gyro axis."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hubodo.pages.curves import Curve, draw_curves
from hubodo.pages.drawing import Drawing, add_legend_above, new_figure, save_figure
from hubodo.pages.page import PageTable, Section
from hubodo.sensors.heading.score import HeadingScore
from hubodo.unit_systems import (
    ANGLE,
    ANGLE_RANDOM_WALK,
    RATE,
    RATE_RANDOM_WALK,
    RATE_SAMPLE,
    DisplayUnit,
    angle_text,
)

if TYPE_CHECKING:
    from hubodo.sensors.heading.result import HeadingResult

_MAX_LISTED_SPANS = 6
_FILTER_COLOUR = "#1b6ca8"
_BASELINE_COLOURS = ("#d1495b", "#8a8d91")

_MAX_BIAS_SIGMA_RATIO = 10.0
"""The bias is plotted where its sigma is below this multiple of the median, as larger bands hide the rest."""


def summarise_heading(result: HeadingResult) -> str:
    """Return the result in one or two sentences."""
    turned, sigma = angle_text(result.track.heading[-1], "+.2f"), angle_text(result.track.sigma[-1], ".2f")
    lead = f"Turned by {turned} ± {sigma} in {result.duration:.0f} s."
    if result.score is not None:
        filter_error = result.score.errors["heading"]
        lead += (
            f" Error against {result.score.source}: {angle_text(filter_error.final, '+.2f')} at the end "
            f"({result.score.final_error_in_sigma:+.1f}σ), {angle_text(filter_error.rms, '.2f')} rms."
        )
    return lead


def describe_spans(spans: Sequence[tuple[float, float]]) -> str:
    """Return times, number and total duration of spans as text."""
    if not spans:
        return "none"
    texts = [f"{a:.1f}..{b:.1f}" for a, b in spans]
    if len(texts) > _MAX_LISTED_SPANS:
        texts[_MAX_LISTED_SPANS - 2 : -1] = ["…"]
    return f"{', '.join(texts)} s ({len(spans)}, together {sum(b - a for a, b in spans):.1f} s)"


def score_rows(result: HeadingResult) -> list[tuple[str, ...]]:
    """Return a header row, then one row per estimate: total turn, and its errors if truth is available."""
    score, unit = result.score, ANGLE.shown()
    head: tuple[str, ...] = ("estimate", f"turned, {unit.name}")
    if score is not None:
        head += tuple(f"{name}, {unit.name}" for name in ("error rms", "at the end", "largest"))
    rows = [head]
    for name, end in result.final_headings().items():
        row: tuple[str, ...] = (name, unit.number(end, "+.3f"))
        if score is not None:
            error = score.errors[name]
            row += (
                unit.number(error.rms, ".3f"),
                unit.number(error.final, "+.3f"),
                unit.number(error.largest, ".3f"),
            )
        rows.append(row)
    return rows


def heading_sections(result: HeadingResult) -> list[Section]:
    """Return the sections of a page: heading, errors, inputs and bias."""
    noise, track = result.noise, result.track
    warmup = [
        ("warm-up C1", _in_unit(result.warmup.c1, RATE, "+.3g")),
        ("warm-up time constant", f"{result.warmup.time_constant:.4g} s"),
    ]
    inputs = [
        ("standstills", describe_spans(result.standstills)),
        ("angle random walk N", _in_unit(noise.angle_random_walk, ANGLE_RANDOM_WALK)),
        ("bias instability B", _in_unit(noise.bias_instability, RATE)),
        ("rate random walk K", _in_unit(noise.rate_random_walk, RATE_RANDOM_WALK)),
        *(warmup if result.warmup.c1 else [("warm-up", "not modelled")]),
        ("scale factor, 1σ", f"{result.scale_sigma:.3g}"),
        ("lag", f"{result.lag:.3g} s"),
        ("gaps", str(len(track.gaps))),
    ]
    rows = score_rows(result)
    sections = [
        Section(
            "Heading",
            " ".join(f"{note[0].upper()}{note[1:]}." for note in result.notes),
            [PageTable(rows[0], rows[1:])],
            [_heading_plot(result)],
        )
    ]
    if result.score is not None:
        sections.append(
            Section("Error", "The band is the estimated sigma (1σ).", figures=[_error_plot(result.score)])
        )
    sections.append(Section("Inputs and bias", "", [PageTable(("", ""), inputs)], [_bias_plot(result)]))
    return sections


def _in_unit(value: float, unit: DisplayUnit, spec: str = ".3g") -> str:
    """Return a value in SI, or in the chosen unit."""
    shown = unit.shown(si_by_default=True)
    return f"{value * shown.factor:{spec}} {shown.name}"


def save_heading_figure(result: HeadingResult, path: Path, title: str) -> None:
    """Write a figure of heading and sigma, or of the error if truth is available.

    Raises OSError if it cannot be written, InputError without matplotlib.
    """
    track, score, unit = result.track, result.score, ANGLE.shown()
    plot = new_figure(8.0, 6.0)
    upper, lower = plot.subplots(2, 1, sharex=True)
    upper.plot(track.t, (track.heading + result.start) * unit.factor, color=_FILTER_COLOUR, label="heading")
    for (name, values), colour in zip(track.baselines.items(), _BASELINE_COLOURS, strict=False):
        upper.plot(track.t, (values + result.start) * unit.factor, color=colour, lw=0.8, label=name)
    upper.set_ylabel(f"heading, {unit.name}")
    upper.set_title(title)
    add_legend_above(plot)
    if score is None:
        lower.plot(track.t, track.sigma * unit.factor, color=_FILTER_COLOUR)
        lower.set_ylabel(f"sigma, {unit.name}")
    else:
        filter_error = score.errors["heading"]
        lower.fill_between(
            filter_error.t,
            -score.sigma * unit.factor,
            score.sigma * unit.factor,
            color=_FILTER_COLOUR,
            alpha=0.18,
            lw=0,
        )
        for (_, error), colour in zip(
            score.errors.items(), (_FILTER_COLOUR, *_BASELINE_COLOURS), strict=False
        ):
            lower.plot(error.t, error.error * unit.factor, color=colour, lw=0.8)
        lower.set_ylabel(f"error against {score.source}, {unit.name}")
    lower.set_xlabel("t, s")
    for axes in (upper, lower):
        axes.grid(True, lw=0.3, color="#d8dce0")
    save_figure(plot, path)


def _heading_plot(result: HeadingResult) -> Drawing:
    track, unit = result.track, ANGLE.shown()
    headings = {"heading": track.heading, **track.baselines}
    plotted = [
        Curve(track.t, (values + result.start) * unit.factor, name, colour)
        for (name, values), colour in zip(
            headings.items(), (_FILTER_COLOUR, *_BASELINE_COLOURS), strict=False
        )
    ]
    return draw_curves(
        plotted[::-1], "t, s", f"heading, {unit.name}"
    )  # reversed, so that the filter is on top


def _error_plot(score: HeadingScore) -> Drawing:
    unit = ANGLE.shown()
    sigma = score.sigma * unit.factor
    band = Curve(score.errors["heading"].t, np.zeros(len(sigma)), "one sigma", _FILTER_COLOUR, 0.0, sigma)
    plotted = [
        Curve(error.t, error.error * unit.factor, name, colour)
        for (name, error), colour in zip(
            score.errors.items(), (_FILTER_COLOUR, *_BASELINE_COLOURS), strict=False
        )
    ]
    return draw_curves([band, *plotted[::-1]], "t, s", f"error, {unit.name}")


def _bias_plot(result: HeadingResult) -> Drawing:
    track, unit = result.track, RATE.shown(RATE_SAMPLE)
    usable = track.sigma_bias <= _MAX_BIAS_SIGMA_RATIO * np.median(track.sigma_bias)
    t, values, sigma = (column[usable] for column in (track.t, track.bias, track.sigma_bias))
    bias = Curve(t, values * unit.factor, "bias", _FILTER_COLOUR, sigma=sigma * unit.factor)
    return draw_curves([bias], "t, s", f"bias of the axis, {unit.name}", height=2.6)
