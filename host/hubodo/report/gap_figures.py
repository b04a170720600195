"""Figures of a gap result: gap per step, residuals before and after, their dependence, and the evidence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from hubodo.arrays import Array
from hubodo.gap.explain.regimes import Trajectory
from hubodo.gap.explain.result import Finding, GapResult
from hubodo.gap.explain.summary import format_probability
from hubodo.gap.problem.problem import CHANNELS
from hubodo.gap.process_noise.residual import Residual
from hubodo.report.page import COLOURS, new_plotly_figure

BEFORE, AFTER, NOISE = COLOURS["right"], COLOURS["left"], COLOURS["truth"]
_FAINT = {BEFORE: "rgba(209,73,91,0.30)", AFTER: "rgba(27,108,168,0.45)"}
_BINS, _CELLS = 500, 30
_STRETCH = 5.0

Channel = tuple[str, int]
"""Name of a node, and row of CHANNELS."""


def steps_figure(result: GapResult) -> go.Figure:
    """Return a figure of the gap after each effect, on fitted and held-out data."""
    labels = ["model as given", *(f"+ {it.effect}<br>{it.scope}" for it in result.found)]
    made = new_plotly_figure("", "gap, in units of the declared noise", height=300)
    fitted = [result.gap.before, *(it.gap.after for it in result.found)]
    outside = [result.held_out_gap.before, *(it.held_out_gap.after for it in result.found)]
    both = (("fitted", fitted, outside, AFTER), ("not fitted (held out)", outside, fitted, COLOURS["fused"]))
    for name, values, others, colour in both:
        made.add_scatter(
            x=labels,
            y=_short(values),
            name=name,
            mode="lines+markers+text",
            text=[f"{value:.3f}" for value in values],
            textposition=[
                f"{'top' if value > other or (value == other and values is fitted) else 'bottom'} center"
                for value, other in zip(values, others, strict=True)
            ],
            textfont={"color": colour},
            line={"color": colour, "width": 2.5},
            marker={"size": 10},
        )
    if result.gap.floor is not None:
        made.add_hline(y=result.gap.floor, line={"dash": "dot", "color": NOISE})
        made.add_annotation(
            x=0.0, xref="paper", y=result.gap.floor, yanchor="top", xanchor="left", showarrow=False,
            text="measured noise", font={"color": NOISE},
        )  # fmt: skip
    low, high = min([*fitted, *outside, result.gap.floor or 9e9]), max([*fitted, *outside])
    room = max(0.35 * (high - low), 0.01)
    made.update_yaxes(range=[low - room, high + room])
    made.update_xaxes(range=[-0.6, len(labels) - 0.4])
    return made


def select_channels(result: GapResult, most: int = 6) -> list[Channel]:
    """Return the channels that each effect changed most; without effects, those with the largest residuals."""
    if not result.found:
        rows = [
            (_rms(residual, row), name, row) for name, row, residual in _measured(result.residual_steps[0])
        ]
        return [(name, row) for _, name, row in sorted(rows, reverse=True)[:4]]
    chosen: dict[Channel, None] = {}
    for first, last in pairwise(result.residual_steps):
        rows = []
        for name, row, residual in _measured(first):
            change = (last[name].predicted[row] - residual.predicted[row]) / residual.declared_channel_sigma(
                row
            )
            rows.append((float(np.linalg.norm(change)), name, row))
        rows.sort(reverse=True)
        chosen |= dict.fromkeys((name, row) for size, name, row in rows[:2] if size > 0.25 * rows[0][0])
    return list(chosen)[:most]


def _measured(residuals: Mapping[str, Residual]) -> Iterator[tuple[str, int, Residual]]:
    for name, residual in residuals.items():
        for row in np.flatnonzero(residual.node.used):
            yield name, int(row), residual


def residual_figure(result: GapResult, chosen: Sequence[Channel]) -> go.Figure:
    """Return a figure of residuals before and after: range and mean of each bin."""
    made = make_subplots(len(chosen), 1, shared_xaxes=True, vertical_spacing=0.35 / (2.5 * len(chosen)))
    for place, (name, row) in enumerate(chosen, 1):
        for label, residuals, colour in _both(result):
            residual = residuals[name]
            t, low, mean, high = envelope(residual.node.t, residual.value[row])
            common = {"legendgroup": label, "hoverinfo": "skip", "mode": "lines"}
            edge = {"width": 0.0, "color": colour}
            made.add_scatter(x=t, y=low, line=edge, showlegend=False, **common, row=place, col=1)
            made.add_scatter(
                x=t, y=high, line=edge, fill="tonexty", fillcolor=_FAINT[colour],
                name=f"{label}: range", showlegend=place == 1, **common, row=place, col=1,
            )  # fmt: skip
            made.add_scatter(
                x=t, y=mean, line={"width": 1.5, "color": colour}, name=f"{label}: mean",
                showlegend=place == 1, legendgroup=f"{label} mean", mode="lines", row=place, col=1,
            )  # fmt: skip
        made.update_yaxes(title_text=format_channel((name, row)), row=place, col=1)
    made.update_xaxes(title_text="time, s", row=len(chosen), col=1)
    return _dressed(made, 90 + 190 * len(chosen))


def regime_figure(
    result: GapResult, chosen: Sequence[Channel], courses: Mapping[str, Trajectory]
) -> go.Figure:
    """Return a figure of the mean residuals over the quantity on which they depend most, per channel."""
    columns = min(2, len(chosen))
    rows = (len(chosen) + 1) // 2
    made = make_subplots(rows, columns, vertical_spacing=0.5 / (1 + 1.5 * rows), horizontal_spacing=0.12)
    for place, (name, row) in enumerate(chosen):
        at = {"row": place // 2 + 1, "col": place % 2 + 1}
        title, over = select_abscissa(result.residual_steps[0][name], row, courses[name])
        for label, residuals, colour in _both(result):
            x, mean, error = bin_means(over, residuals[name].value[row])
            made.add_scatter(
                x=x, y=mean, error_y={"array": error, "thickness": 1, "width": 0},
                name=label, legendgroup=label, showlegend=place == 0,
                mode="lines+markers", marker={"size": 5},
                line={"color": colour, "width": 1.5}, **at,
            )  # fmt: skip
        made.update_xaxes(title_text=title, **at)
        made.update_yaxes(title_text=format_channel((name, row)), **at)
    return _dressed(made, 100 + 270 * rows)


def gap_over_time_figure(result: GapResult) -> go.Figure:
    """Return a figure of the gap in each five-second interval, before and after."""
    made = new_plotly_figure("time, s", "gap in 5 s", height=260)
    for label, residuals, colour in _both(result):
        t, values = gap_over_time(residuals)
        made.add_scatter(
            x=t, y=values, name=label, mode="lines", line={"color": colour, "width": 2.0, "shape": "hvh"}
        )
    made.add_hline(y=1.0, line={"dash": "dot", "color": NOISE})
    return made


def evidence_figure(finding: Finding, most: int = 5) -> go.Figure:
    """Return a figure of the probabilities of all candidate effects for one finding."""
    rows = finding.rivals[:most] or ((finding.effect, finding.scope, 0.0, finding.confidence),)
    # Small probabilities are narrower than a pixel, so each bar is labelled with its value.
    labels = [f"{effect} ({scope})" for effect, scope, _, _ in rows]
    made = new_plotly_figure("probability, %", "", height=110 + 34 * len(rows))
    made.add_bar(
        x=[100.0 * share for *_, share in rows],
        y=labels,
        orientation="h",
        text=[f"{format_probability(share)}, gain {gain:.0f}" for _, _, gain, share in rows],
        textposition=["inside" if share > 0.5 else "outside" for *_, share in rows],
        marker={"color": [NOISE if k else AFTER for k in range(len(rows))]},
    )
    made.update_xaxes(range=[0, 100])
    made.update_yaxes(autorange="reversed", automargin=True)
    return made


def format_channel(channel: Channel) -> str:
    """Return name and unit of a channel."""
    name, row = channel
    return f"{name}.{CHANNELS[row]}, {'rad/s' if row < 3 else 'm/s²'}"


def envelope(t: Array, values: Array) -> tuple[Array, Array, Array, Array]:
    """Return t, minimum, mean and maximum of values in at most 500 bins of equal length, (K,) each."""
    edges = np.unique(np.linspace(0, len(t), min(_BINS, len(t)) + 1).astype(int))
    count = np.diff(edges)
    mean = np.add.reduceat(values, edges[:-1]) / count
    low, high = np.minimum.reduceat(values, edges[:-1]), np.maximum.reduceat(values, edges[:-1])
    return _short(t[edges[:-1]]), _short(low), _short(mean), _short(high)


def bin_means(over: Array, values: Array) -> tuple[Array, Array, Array]:
    """Return centre, mean and standard error of values in up to 30 bins over another series."""
    low, high = np.percentile(over, [0.5, 99.5])
    cell = np.clip(((over - low) / max(high - low, 1e-12) * _CELLS).astype(int), 0, _CELLS - 1)
    count = np.bincount(cell, minlength=_CELLS)
    kept = count >= 20
    total = np.bincount(cell, values, _CELLS)[kept] / count[kept]
    square = np.bincount(cell, values**2, _CELLS)[kept] / count[kept]
    error = np.sqrt(np.maximum(square - total**2, 0.0) / count[kept])
    return _short(np.bincount(cell, over, _CELLS)[kept] / count[kept]), _short(total), _short(error)


def select_abscissa(residual: Residual, row: int, course: Trajectory) -> tuple[str, Array]:
    """Return label and series of the quantity on which the binned residual depends most significantly."""
    options: list[tuple[str, Array]] = []
    if course.angle is not None:
        options.append(("angle of the wheel, °", np.degrees(np.mod(course.angle, 2.0 * np.pi))))
        options.append(("spin, rad/s", course.spin))
        options.append(("change of the spin, rad/s²", course.spin_slope))
    options.append(("yaw rate, rad/s", course.yaw_rate))
    options.append(("temperature, °C", course.temperature))
    options.append(("time, s", course.t))
    scored = []
    for title, series in options:
        if np.ptp(series) > 1e-6:
            _, mean, error = bin_means(series, residual.value[row])
            ok = error > 0.0
            scored.append((float(np.sum((mean[ok] / error[ok]) ** 2)), title, series))
    best = max(scored, key=lambda it: it[0])
    return best[1], best[2]


def gap_over_time(residuals: Mapping[str, Residual]) -> tuple[Array, Array]:
    """Return the centre of each five-second interval and the gap in it, (K,) each."""
    last = max(float(residual.node.t[-1]) for residual in residuals.values())
    first = min(float(residual.node.t[0]) for residual in residuals.values())
    count = max(1, int((last - first) / _STRETCH))
    total, number = np.zeros(count), np.zeros(count)
    for residual in residuals.values():
        cell = np.clip(((residual.node.t - first) / _STRETCH).astype(int), 0, count - 1)
        z = ((residual.value / residual.declared_sigma)[residual.node.used] ** 2).sum(axis=0)
        total += np.bincount(cell, z, count)
        number += np.bincount(cell, minlength=count) * residual.node.used.sum()
    kept = number > 0
    sizes = np.asarray(np.sqrt(total[kept] / number[kept]), np.float64)
    middle = first + (np.arange(count) + 0.5) * _STRETCH
    return _short(middle[kept]), _short(sizes)


def _both(result: GapResult) -> list[tuple[str, Mapping[str, Residual], str]]:
    """Return label, residuals and colour before and, if an effect was found, after."""
    made = [("before", result.residual_steps[0], BEFORE)]
    return [*made, ("after", result.residual_steps[-1], AFTER)] if result.found else made


def _rms(residual: Residual, row: int) -> float:
    return float(np.sqrt(np.mean((residual.value[row] / residual.declared_channel_sigma(row)) ** 2)))


def _short(values: Sequence[float] | NDArray[Any]) -> Array:
    """Round to five significant digits, which suffices for a figure and keeps the file small."""
    array = np.asarray(values, np.float64)
    largest = float(np.abs(array).max(initial=0.0))
    return np.round(array, max(0, 5 - int(np.floor(np.log10(largest)))) if largest > 0.0 else 0)


def _dressed(made: go.Figure, height: int) -> go.Figure:
    made.update_layout(
        template="plotly_white",
        height=height,
        margin={"l": 80, "r": 20, "t": 40, "b": 50},
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0},
    )
    return made
