"""Summary, tables and figures of the heading of one gyro axis."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from hubodo.report.curves import Curve, draw_curves
from hubodo.report.drawing import Drawing, new_figure, save_figure
from hubodo.report.page import PageTable, Section
from hubodo.sensors.heading.result import HeadingAnalysis
from hubodo.sensors.heading.score import HeadingScore

_DEG = math.degrees(1.0)
_OURS = "#1b6ca8"
_RIVALS = ("#d1495b", "#8a8d91")

_KNOWN = 10.0
"""The bias is plotted where its sigma is below this multiple of the median, as larger bands hide the rest."""


def summarise_heading(report: HeadingAnalysis) -> str:
    """Return the result in one or two sentences."""
    turned, sigma = report.track.heading[-1] * _DEG, report.track.sigma[-1] * _DEG
    lead = f"Turned by {turned:+.2f}° ± {sigma:.2f}° in {report.duration:.0f} s."
    if report.score is not None:
        ours = report.score.errors["heading"]
        lead += (
            f" Error against {report.score.source}: {ours.final * _DEG:+.2f}° at the end "
            f"({report.score.final_error_in_sigma:+.1f}σ), {ours.rms * _DEG:.2f}° rms."
        )
    return lead


def score_rows(report: HeadingAnalysis) -> list[tuple[str, ...]]:
    """Return a header row, then one row per estimate: total turn, and its errors if truth is available."""
    score = report.score
    head: tuple[str, ...] = ("estimate", "turned, °")
    if score is not None:
        head += ("error rms, °", "at the end, °", "largest, °")
    rows = [head]
    for name, end in report.final_headings().items():
        row: tuple[str, ...] = (name, f"{end * _DEG:+.3f}")
        if score is not None:
            error = score.errors[name]
            row += (f"{error.rms * _DEG:.3f}", f"{error.final * _DEG:+.3f}", f"{error.largest * _DEG:.3f}")
        rows.append(row)
    return rows


def heading_sections(report: HeadingAnalysis) -> list[Section]:
    """Return the sections of a page: heading, errors, inputs and bias."""
    noise, track = report.noise, report.track
    grounds = [
        ("standstills", f"{len(report.standstills)}, {sum(b - a for a, b in report.standstills):.1f} s"),
        ("angle random walk N", f"{noise.angle_random_walk:.3g} rad/√s"),
        ("bias instability B", f"{noise.bias_instability:.3g} rad/s"),
        ("rate random walk K", f"{noise.rate_random_walk:.3g} rad/s/√s"),
        ("warm-up C1", f"{report.warmup.c1:+.3g} rad/s"),
        ("warm-up time constant", f"{report.warmup.time_constant:.4g} s"),
        ("scale factor, 1σ", f"{report.scale_sigma:.3g}"),
        ("lag", f"{report.lag:.3g} s"),
        ("gaps", str(len(track.gaps))),
    ]
    rows = score_rows(report)
    sections = [
        Section(
            "Heading",
            " ".join(f"{note}." for note in report.notes),
            [PageTable(rows[0], rows[1:])],
            [_course(report)],
        )
    ]
    if report.score is not None:
        sections.append(
            Section("Error", "The band is the estimated sigma (1σ).", figures=[_error(report.score)])
        )
    sections.append(Section("Inputs and bias", "", [PageTable(("", ""), grounds)], [_bias(report)]))
    return sections


def save_heading_figure(report: HeadingAnalysis, path: Path, title: str) -> None:
    """Write a figure of heading and sigma, or of the error if truth is available.

    Raises OSError if it cannot be written, InputError without matplotlib.
    """
    track, score = report.track, report.score
    made = new_figure(8.0, 6.0)
    upper, lower = made.subplots(2, 1, sharex=True)
    upper.plot(track.t, (track.heading + report.start) * _DEG, color=_OURS, label="heading")
    for (name, values), colour in zip(track.baselines.items(), _RIVALS, strict=False):
        upper.plot(track.t, (values + report.start) * _DEG, color=colour, lw=0.8, label=name)
    upper.set_ylabel("heading, °")
    upper.set_title(title)
    upper.legend(fontsize=8)
    if score is None:
        lower.plot(track.t, track.sigma * _DEG, color=_OURS)
        lower.set_ylabel("sigma, °")
    else:
        ours = score.errors["heading"]
        lower.fill_between(ours.t, -score.sigma * _DEG, score.sigma * _DEG, color=_OURS, alpha=0.18, lw=0)
        for (_, error), colour in zip(score.errors.items(), (_OURS, *_RIVALS), strict=False):
            lower.plot(error.t, error.error * _DEG, color=colour, lw=0.8)
        lower.set_ylabel(f"error against {score.source}, °")
    lower.set_xlabel("t, s")
    for axes in (upper, lower):
        axes.grid(True, lw=0.3, color="#d8dce0")
    save_figure(made, path)


def _course(report: HeadingAnalysis) -> Drawing:
    track = report.track
    courses = {"heading": track.heading, **track.baselines}
    shown = [
        Curve(track.t, (values + report.start) * _DEG, name, colour)
        for (name, values), colour in zip(courses.items(), (_OURS, *_RIVALS), strict=False)
    ]
    return draw_curves(shown[::-1], "t, s", "heading, °")  # reversed, so that the filter is on top


def _error(score: HeadingScore) -> Drawing:
    sigma = score.sigma * _DEG
    band = Curve(score.errors["heading"].t, np.zeros(len(sigma)), "one sigma", _OURS, 0.0, sigma)
    shown = [
        Curve(error.t, error.error * _DEG, name, colour)
        for (name, error), colour in zip(score.errors.items(), (_OURS, *_RIVALS), strict=False)
    ]
    return draw_curves([band, *shown[::-1]], "t, s", "error, °")


def _bias(report: HeadingAnalysis) -> Drawing:
    track = report.track
    known = track.sigma_bias <= _KNOWN * np.median(track.sigma_bias)
    t, values, sigma = (column[known] for column in (track.t, track.bias, track.sigma_bias))
    bias = Curve(t, values * _DEG, "bias", _OURS, sigma=sigma * _DEG)
    return draw_curves([bias], "t, s", "bias of the axis, °/s", height=2.6)
