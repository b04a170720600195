"""The heading of one gyro axis as words, tables, interactive figures and a PNG."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from hubodo.report.drawing import blank, save
from hubodo.report.page import Grid, Section, figure
from hubodo.sensors.heading.summary import HeadingReport

_DEG = math.degrees(1.0)
_OURS, _BAND = "#1b6ca8", "rgba(27, 108, 168, 0.18)"
_RIVALS = ("#d1495b", "#8a8d91")
_POINTS = 4000
"""Drawn of each course; more cannot be told apart on a screen."""


def heading_lead(report: HeadingReport) -> str:
    """The result in one or two sentences."""
    turned, sigma = report.track.heading[-1] * _DEG, report.track.sigma[-1] * _DEG
    lead = f"After {report.duration:.0f} s turned by {turned:+.2f}° ± {sigma:.2f}°."
    if report.score is not None:
        ours = report.score.errors["heading"]
        lead += (
            f" Beside {report.score.source}: {ours.end * _DEG:+.2f}° at the end "
            f"({report.score.end_in_sigma:+.1f} sigma), {ours.rms * _DEG:.2f}° rms."
        )
    return lead


def score_rows(report: HeadingReport) -> list[tuple[str, ...]]:
    """A row of headings, then one for each estimate: turned, and its error where there is a truth."""
    score = report.score
    head: tuple[str, ...] = ("estimate", "turned, °")
    if score is not None:
        head += ("error rms, °", "at the end, °", "worst, °")
    rows = [head]
    for name, end in report.ends().items():
        row: tuple[str, ...] = (name, f"{end * _DEG:+.3f}")
        if score is not None:
            error = score.errors[name]
            row += (f"{error.rms * _DEG:.3f}", f"{error.end * _DEG:+.3f}", f"{error.worst * _DEG:.3f}")
        rows.append(row)
    return rows


def heading_sections(report: HeadingReport) -> list[Section]:
    """Course, error, bias, and what it rests on, for a page."""
    noise, track = report.noise, report.track
    grounds = [
        ("standstills", f"{len(report.rests)}, {sum(b - a for a, b in report.rests):.1f} s"),
        ("angle random walk N", f"{noise.angle_random_walk:.3g} rad/√s"),
        ("bias instability B", f"{noise.bias_instability:.3g} rad/s"),
        ("rate random walk K", f"{noise.rate_random_walk:.3g} rad/s/√s"),
        ("warm-up C1", f"{report.warmup.c1:+.3g} rad/s"),
        ("warm-up time constant", f"{report.warmup.time_constant:.4g} s"),
        ("scale, 1 sigma", f"{report.scale_sigma:.3g}"),
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
            Section("Error", "The band is one sigma, as the estimate says it.", figures=[_error(report)])
        )
    sections.append(Section("What it rests on", "", [Grid(("", ""), grounds)], [_bias(report)]))
    return sections


def heading_figure(report: HeadingReport, path: Path, title: str) -> None:
    """Course and sigma, and the error where there is a truth.

    Raises OSError where it cannot be written, InputError without matplotlib.
    """
    track, score = report.track, report.score
    made = blank(8.0, 6.0)
    upper, lower = made.subplots(2, 1, sharex=True)
    upper.plot(track.t, (track.heading + report.start) * _DEG, color=_OURS, label="heading")
    for (name, values), colour in zip(track.rivals.items(), _RIVALS, strict=False):
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


def _thin(count: int) -> slice:
    return slice(None, None, max(1, count // _POINTS))


def _course(report: HeadingReport) -> go.Figure:
    track = report.track
    made = figure("t, s", "heading, °")
    some = _thin(len(track.t))
    courses = {"heading": track.heading, **track.rivals}
    for (name, values), colour in zip(courses.items(), (_OURS, *_RIVALS), strict=False):
        y = (values[some] + report.start) * _DEG
        made.add_scatter(x=track.t[some], y=y, mode="lines", name=name, line={"color": colour, "width": 1.2})
    return made


def _error(report: HeadingReport) -> go.Figure:
    made = figure("t, s", "error, °")
    if report.score is None:
        return made
    errors, sigma = report.score.errors, report.score.sigma
    t = errors["heading"].t
    some = _thin(len(t))
    band = np.concatenate([sigma[some], -sigma[some][::-1]]) * _DEG
    made.add_scatter(
        x=np.concatenate([t[some], t[some][::-1]]),
        y=band,
        fill="toself",
        fillcolor=_BAND,
        line={"width": 0},
        name="one sigma",
    )
    for (name, error), colour in zip(errors.items(), (_OURS, *_RIVALS), strict=False):
        y = error.error[some] * _DEG
        made.add_scatter(x=t[some], y=y, mode="lines", name=name, line={"color": colour, "width": 1.2})
    return made


def _bias(report: HeadingReport) -> go.Figure:
    track = report.track
    made = figure("t, s", "bias of the axis, deg/s", height=260)
    some = _thin(len(track.t))
    t, bias, sigma = (values[some] for values in (track.t, track.bias * _DEG, track.sigma_bias * _DEG))
    made.add_scatter(
        x=np.concatenate([t, t[::-1]]),
        y=np.concatenate([bias + sigma, (bias - sigma)[::-1]]),
        fill="toself",
        fillcolor=_BAND,
        line={"width": 0},
        name="one sigma",
    )
    made.add_scatter(x=t, y=bias, mode="lines", name="bias", line={"color": _OURS})
    return made
