"""The heading of one gyro axis as words, tables, drawings and a PNG."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from hubodo.report.curves import Curve, curves
from hubodo.report.drawing import Drawing, blank, save
from hubodo.report.page import Grid, Section
from hubodo.sensors.heading.result import HeadingAnalysis
from hubodo.sensors.heading.score import HeadingScore

_DEG = math.degrees(1.0)
_OURS = "#1b6ca8"
_RIVALS = ("#d1495b", "#8a8d91")

_KNOWN = 10.0
"""A bias is drawn from where its sigma is less than so many times the usual; before, it hides the rest."""


def heading_lead(report: HeadingAnalysis) -> str:
    """The result in one or two sentences."""
    turned, sigma = report.track.heading[-1] * _DEG, report.track.sigma[-1] * _DEG
    lead = f"After {report.duration:.0f} s turned by {turned:+.2f}° ± {sigma:.2f}°."
    if report.score is not None:
        ours = report.score.errors["heading"]
        lead += (
            f" Beside {report.score.source}: {ours.final * _DEG:+.2f}° at the end "
            f"({report.score.final_error_in_sigma:+.1f} sigma), {ours.rms * _DEG:.2f}° rms."
        )
    return lead


def score_rows(report: HeadingAnalysis) -> list[tuple[str, ...]]:
    """A row of headings, then one for each estimate: turned, and its error where there is a truth."""
    score = report.score
    head: tuple[str, ...] = ("estimate", "turned, °")
    if score is not None:
        head += ("error rms, °", "at the end, °", "worst, °")
    rows = [head]
    for name, end in report.final_headings().items():
        row: tuple[str, ...] = (name, f"{end * _DEG:+.3f}")
        if score is not None:
            error = score.errors[name]
            row += (f"{error.rms * _DEG:.3f}", f"{error.final * _DEG:+.3f}", f"{error.largest * _DEG:.3f}")
        rows.append(row)
    return rows


def heading_sections(report: HeadingAnalysis) -> list[Section]:
    """Course, error, bias, and what it rests on, for a page."""
    noise, track = report.noise, report.track
    grounds = [
        ("standstills", f"{len(report.standstills)}, {sum(b - a for a, b in report.standstills):.1f} s"),
        ("angle random walk N", f"{noise.angle_random_walk:.3g} rad/√s"),
        ("bias instability B", f"{noise.bias_instability:.3g} rad/s"),
        ("rate random walk K", f"{noise.rate_random_walk:.3g} rad/s/√s"),
        ("warm-up C1", f"{report.warmup.c1:+.3g} rad/s"),
        ("warm-up time constant", f"{report.warmup.time_constant:.4g} s"),
        ("scale, 1 sigma", f"{report.scale_sigma:.3g}"),
        ("lag", f"{report.lag:.3g} s"),
        ("gaps", str(len(track.gaps))),
    ]
    rows = score_rows(report)
    sections = [
        Section(
            "Heading",
            " ".join(f"{note}." for note in report.notes),
            [Grid(rows[0], rows[1:])],
            [_course(report)],
        )
    ]
    if report.score is not None:
        sections.append(
            Section(
                "Error", "The band is one sigma, as the estimate says it.", figures=[_error(report.score)]
            )
        )
    sections.append(Section("What it rests on", "", [Grid(("", ""), grounds)], [_bias(report)]))
    return sections


def heading_figure(report: HeadingAnalysis, path: Path, title: str) -> None:
    """Course and sigma, and the error where there is a truth.

    Raises OSError where it cannot be written, InputError without matplotlib.
    """
    track, score = report.track, report.score
    made = blank(8.0, 6.0)
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
        lower.set_ylabel(f"error beside {score.source}, °")
    lower.set_xlabel("t, s")
    for axes in (upper, lower):
        axes.grid(True, lw=0.3, color="#d8dce0")
    save(made, path)


def _course(report: HeadingAnalysis) -> Drawing:
    track = report.track
    courses = {"heading": track.heading, **track.baselines}
    shown = [
        Curve(track.t, (values + report.start) * _DEG, name, colour)
        for (name, values), colour in zip(courses.items(), (_OURS, *_RIVALS), strict=False)
    ]
    return curves(shown[::-1], "t, s", "heading, °")  # ours on top


def _error(score: HeadingScore) -> Drawing:
    sigma = score.sigma * _DEG
    band = Curve(score.errors["heading"].t, np.zeros(len(sigma)), "one sigma", _OURS, 0.0, sigma)
    shown = [
        Curve(error.t, error.error * _DEG, name, colour)
        for (name, error), colour in zip(score.errors.items(), (_OURS, *_RIVALS), strict=False)
    ]
    return curves([band, *shown[::-1]], "t, s", "error, °")


def _bias(report: HeadingAnalysis) -> Drawing:
    track = report.track
    known = track.sigma_bias <= _KNOWN * np.median(track.sigma_bias)
    t, values, sigma = (column[known] for column in (track.t, track.bias, track.sigma_bias))
    bias = Curve(t, values * _DEG, "bias", _OURS, sigma=sigma * _DEG)
    return curves([bias], "t, s", "bias of the axis, °/s", height=2.6)
