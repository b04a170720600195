"""Figures of a gap result: gap per step, residuals before and after, their dependence, and the evidence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from hubodo.arrays import Array
from hubodo.gap.explain.regimes import Trajectory
from hubodo.gap.explain.result import Finding
from hubodo.gap.explain.summary import format_probability
from hubodo.gap.problem.problem import CHANNELS
from hubodo.gap.process_noise.residual import Residual
from hubodo.pages.page import COLOURS, new_plotly_figure

if TYPE_CHECKING:
    from hubodo.gap.explain.missing_effects import MissingEffects

# Not red: a residual is a result, not a warning.
BEFORE, AFTER, NOISE = "#b7791f", COLOURS["left"], COLOURS["truth"]
_BAND_COLOURS = {BEFORE: "rgba(183,121,31,0.30)", AFTER: "rgba(27,108,168,0.45)"}
_MAX_BINS, _REGIME_BINS = 500, 30
_INTERVAL_S = 5.0

Channel = tuple[str, int]
"""Name of a node, and row of CHANNELS."""


def steps_figure(result: MissingEffects) -> go.Figure:
    """Return a figure of the gap after each effect, on fitted and held-out data."""
    labels = ["model as given", *(f"+ {finding.effect}<br>{finding.scope}" for finding in result.listed)]
    plot = new_plotly_figure("", "gap, in units of the declared noise", height=300)
    fitted = [result.gap.before, *(finding.gap.after for finding in result.listed)]
    held_out = [result.held_out_gap.before, *(finding.held_out_gap.after for finding in result.listed)]
    series = (
        ("fitted", fitted, held_out, AFTER),
        ("not fitted (held out)", held_out, fitted, COLOURS["fused"]),
    )
    for name, values, others, colour in series:
        plot.add_scatter(
            x=labels,
            y=_round_digits(values),
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
        plot.add_hline(y=result.gap.floor, line={"dash": "dot", "color": NOISE})
        plot.add_annotation(
            x=0.0, xref="paper", y=result.gap.floor, yanchor="top", xanchor="left", showarrow=False,
            text="measured noise", font={"color": NOISE},
        )  # fmt: skip
    low, high = min([*fitted, *held_out, result.gap.floor or 9e9]), max([*fitted, *held_out])
    margin = max(0.35 * (high - low), 0.01)
    plot.update_yaxes(range=[low - margin, high + margin])
    plot.update_xaxes(range=[-0.6, len(labels) - 0.4])
    return plot


def select_channels(result: MissingEffects, max_rows: int = 6) -> list[Channel]:
    """Return the channels with the largest change by each effect.

    Without effects, those with the largest residuals.
    """
    if not result.found:
        rows = [
            (_rms(residual, row), name, row) for name, row, residual in _measured(result.residual_steps[0])
        ]
        return [(name, row) for _, name, row in sorted(rows, reverse=True)[:4]]
    channels: dict[Channel, None] = {}
    for first, last in pairwise(result.residual_steps):
        rows = []
        for name, row, residual in _measured(first):
            change = (last[name].predicted[row] - residual.predicted[row]) / residual.declared_channel_sigma(
                row
            )
            rows.append((float(np.linalg.norm(change)), name, row))
        rows.sort(reverse=True)
        channels |= dict.fromkeys((name, row) for size, name, row in rows[:2] if size > 0.25 * rows[0][0])
    return list(channels)[:max_rows]


def _measured(residuals: Mapping[str, Residual]) -> Iterator[tuple[str, int, Residual]]:
    for name, residual in residuals.items():
        for row in np.flatnonzero(residual.node.used):
            yield name, int(row), residual


def residual_figure(result: MissingEffects, channels: Sequence[Channel]) -> go.Figure:
    """Return a figure of residuals before and after: range and mean of each bin."""
    plot = make_subplots(len(channels), 1, shared_xaxes=True, vertical_spacing=0.35 / (2.5 * len(channels)))
    for position, (name, row) in enumerate(channels, 1):
        for label, residuals, colour in _before_and_after(result):
            residual = residuals[name]
            t, low, mean, high = envelope(residual.node.t, residual.value[row])
            common = {"legendgroup": label, "hoverinfo": "skip", "mode": "lines"}
            edge = {"width": 0.0, "color": colour}
            plot.add_scatter(x=t, y=low, line=edge, showlegend=False, **common, row=position, col=1)
            plot.add_scatter(
                x=t, y=high, line=edge, fill="tonexty", fillcolor=_BAND_COLOURS[colour],
                name=f"{label}: range", showlegend=position == 1, **common, row=position, col=1,
            )  # fmt: skip
            plot.add_scatter(
                x=t, y=mean, line={"width": 1.5, "color": colour}, name=f"{label}: mean",
                showlegend=position == 1, legendgroup=f"{label} mean", mode="lines", row=position, col=1,
            )  # fmt: skip
        plot.update_yaxes(title_text=format_channel((name, row)), row=position, col=1)
    plot.update_xaxes(title_text="time, s", row=len(channels), col=1)
    return _apply_layout(plot, 90 + 190 * len(channels))


def regime_figure(
    result: MissingEffects, channels: Sequence[Channel], trajectories: Mapping[str, Trajectory]
) -> go.Figure:
    """Return a figure of the mean residuals over the quantity on which they depend most, per channel."""
    columns = min(2, len(channels))
    rows = (len(channels) + 1) // 2
    plot = make_subplots(rows, columns, vertical_spacing=0.5 / (1 + 1.5 * rows), horizontal_spacing=0.12)
    for position, (name, row) in enumerate(channels):
        at = {"row": position // 2 + 1, "col": position % 2 + 1}
        title, abscissa = select_abscissa(result.residual_steps[0][name], row, trajectories[name])
        for label, residuals, colour in _before_and_after(result):
            x, mean, error = bin_means(abscissa, residuals[name].value[row])
            plot.add_scatter(
                x=x, y=mean, error_y={"array": error, "thickness": 1, "width": 0},
                name=label, legendgroup=label, showlegend=position == 0,
                mode="lines+markers", marker={"size": 5},
                line={"color": colour, "width": 1.5}, **at,
            )  # fmt: skip
        plot.update_xaxes(title_text=title, **at)
        plot.update_yaxes(title_text=format_channel((name, row)), **at)
    return _apply_layout(plot, 100 + 270 * rows)


def gap_over_time_figure(result: MissingEffects) -> go.Figure:
    """Return a figure of the gap in each five-second interval, before and after."""
    plot = new_plotly_figure("time, s", "gap in 5 s", height=260)
    for label, residuals, colour in _before_and_after(result):
        t, values = gap_over_time(residuals)
        plot.add_scatter(
            x=t, y=values, name=label, mode="lines", line={"color": colour, "width": 2.0, "shape": "hvh"}
        )
    plot.add_hline(y=1.0, line={"dash": "dot", "color": NOISE})
    return plot


def evidence_figure(finding: Finding, max_rows: int = 5) -> go.Figure:
    """Return a figure of the probabilities of all candidate effects for one finding."""
    rows = finding.rivals[:max_rows] or ((finding.effect, finding.scope, 0.0, finding.confidence),)
    # Small probabilities are narrower than a pixel, so each bar is labelled with its value.
    labels = [f"{effect} ({scope})" for effect, scope, _, _ in rows]
    plot = new_plotly_figure("probability, %", "", height=110 + 34 * len(rows))
    plot.add_bar(
        x=[100.0 * share for *_, share in rows],
        y=labels,
        orientation="h",
        text=[f"{format_probability(share)}, gain {float(f'{gain:.4g}'):,.0f}" for _, _, gain, share in rows],
        textposition=["inside" if share > 0.5 else "outside" for *_, share in rows],
        marker={"color": [NOISE if k else AFTER for k in range(len(rows))]},
    )
    plot.update_xaxes(range=[0, 100])
    plot.update_yaxes(autorange="reversed", automargin=True)
    return plot


def format_channel(channel: Channel) -> str:
    """Return name and unit of a channel."""
    name, row = channel
    return f"{name}.{CHANNELS[row]}, {'rad/s' if row < 3 else 'm/s²'}"


def envelope(t: Array, values: Array) -> tuple[Array, Array, Array, Array]:
    """Return t, minimum, mean and maximum of values in at most 500 bins of equal length, (K,) each."""
    edges = np.unique(np.linspace(0, len(t), min(_MAX_BINS, len(t)) + 1).astype(int))
    count = np.diff(edges)
    mean = np.add.reduceat(values, edges[:-1]) / count
    low, high = np.minimum.reduceat(values, edges[:-1]), np.maximum.reduceat(values, edges[:-1])
    return _round_digits(t[edges[:-1]]), _round_digits(low), _round_digits(mean), _round_digits(high)


def bin_means(abscissa: Array, values: Array) -> tuple[Array, Array, Array]:
    """Return centre, mean and standard error of values in up to 30 bins over another series."""
    low, high = np.percentile(abscissa, [0.5, 99.5])
    cell = np.clip(
        ((abscissa - low) / max(high - low, 1e-12) * _REGIME_BINS).astype(int), 0, _REGIME_BINS - 1
    )
    count = np.bincount(cell, minlength=_REGIME_BINS)
    occupied = count >= 20
    total = np.bincount(cell, values, _REGIME_BINS)[occupied] / count[occupied]
    mean_square = np.bincount(cell, values**2, _REGIME_BINS)[occupied] / count[occupied]
    error = np.sqrt(np.maximum(mean_square - total**2, 0.0) / count[occupied])
    return (
        _round_digits(np.bincount(cell, abscissa, _REGIME_BINS)[occupied] / count[occupied]),
        _round_digits(total),
        _round_digits(error),
    )


def select_abscissa(residual: Residual, row: int, trajectory: Trajectory) -> tuple[str, Array]:
    """Return label and series of the quantity on which the binned residual depends most significantly."""
    options: list[tuple[str, Array]] = []
    if trajectory.angle is not None:
        options.append(("angle of the wheel, °", np.degrees(np.mod(trajectory.angle, 2.0 * np.pi))))
        options.append(("spin, rad/s", trajectory.spin))
        options.append(("change of the spin, rad/s²", trajectory.spin_slope))
    options.append(("yaw rate, rad/s", trajectory.yaw_rate))
    options.append(("temperature, °C", trajectory.temperature))
    options.append(("time, s", trajectory.t))
    scored = []
    for title, series in options:
        if np.ptp(series) > 1e-6:
            _, mean, error = bin_means(series, residual.value[row])
            ok = error > 0.0
            scored.append((float(np.sum((mean[ok] / error[ok]) ** 2)), title, series))
    best = max(scored, key=lambda finding: finding[0])
    return best[1], best[2]


def gap_over_time(residuals: Mapping[str, Residual]) -> tuple[Array, Array]:
    """Return the centre of each five-second interval and the gap in it, (K,) each."""
    last = max(float(residual.node.t[-1]) for residual in residuals.values())
    first = min(float(residual.node.t[0]) for residual in residuals.values())
    count = max(1, int((last - first) / _INTERVAL_S))
    total, number = np.zeros(count), np.zeros(count)
    for residual in residuals.values():
        cell = np.clip(((residual.node.t - first) / _INTERVAL_S).astype(int), 0, count - 1)
        z = ((residual.value / residual.declared_sigma)[residual.node.used] ** 2).sum(axis=0)
        total += np.bincount(cell, z, count)
        number += np.bincount(cell, minlength=count) * residual.node.used.sum()
    occupied = number > 0
    sizes = np.asarray(np.sqrt(total[occupied] / number[occupied]), np.float64)
    middle = first + (np.arange(count) + 0.5) * _INTERVAL_S
    return _round_digits(middle[occupied]), _round_digits(sizes)


def _before_and_after(result: MissingEffects) -> list[tuple[str, Mapping[str, Residual], str]]:
    """Return label, residuals and colour before and, if an effect was found, after."""
    plot = [("before", result.residual_steps[0], BEFORE)]
    return [*plot, ("after", result.residual_steps[-1], AFTER)] if result.found else plot


def _rms(residual: Residual, row: int) -> float:
    return float(np.sqrt(np.mean((residual.value[row] / residual.declared_channel_sigma(row)) ** 2)))


def _round_digits(values: Sequence[float] | NDArray[Any]) -> Array:
    """Round to five significant digits, which suffices for a figure and keeps the file small."""
    array = np.asarray(values, np.float64)
    largest = float(np.abs(array).max(initial=0.0))
    return np.round(array, max(0, 5 - int(np.floor(np.log10(largest)))) if largest > 0.0 else 0)


def _apply_layout(plot: go.Figure, height: int) -> go.Figure:
    plot.update_layout(
        template="plotly_white",
        height=height,
        margin={"l": 80, "r": 20, "t": 40, "b": 50},
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0},
    )
    return plot
