"""What a node's own filter said of its gyro, as words, a table and a figure."""

from __future__ import annotations

import math

import numpy as np
import plotly.graph_objects as go

from hubodo.ingest.node.bias_filter import filter_words
from hubodo.recording import Table
from hubodo.report.page import COLOURS, Section, figure
from hubowire.messages import FilterState

_DEG = math.degrees(1.0)
_MOST_POINTS = 2000
_AXES = {"x": COLOURS["left"], "y": COLOURS["right"], "z": COLOURS["fused"]}


def bias_filter_section(node: str, table: Table) -> tuple[Section | None, str]:
    """The node's estimate over time with its sigma, and the finding in one line; None without a bias.

    table: as in `Recording.bias_filters`.
    """
    known = table["state"] == FilterState.TRACKING
    if not known.any():
        return None, f"{node}: its own filter never had a bias: no initialisation, and none in its settings"
    last = {name: float(table[name][known][-1]) for name in table}
    fact = f"{node}: its own filter's bias, at the end {filter_words(last)}"
    text = (
        "Each axis with 1 sigma of the initial bias where the node knows it. Rate and bias are seen only as "
        "their sum: what an axis follows beyond its initialisation and the warm-up rests on the node's gains."
    )
    return Section(f"{node}: bias by its own filter", text, figures=[_drawn(table, known)]), fact


def _drawn(table: Table, known: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> go.Figure:
    drawn = figure("time, s", "bias, °/s")
    rows = np.flatnonzero(known)
    rows = rows[:: max(1, math.ceil(len(rows) / _MOST_POINTS))]
    t = np.round(table.t[rows], 3)
    for axis, colour in _AXES.items():
        bias, sigma = (table[f"{what}_{axis}"][rows] * _DEG for what in ("bias", "sigma"))
        sigma = np.nan_to_num(sigma)
        band = np.concatenate([bias + sigma, (bias - sigma)[::-1]])
        drawn.add_trace(
            go.Scatter(
                x=np.concatenate([t, t[::-1]]),
                y=np.round(band, 5),
                fill="toself",
                line={"width": 0},
                fillcolor=colour,
                opacity=0.2,
                showlegend=False,
                hoverinfo="skip",
            )
        )
        drawn.add_trace(
            go.Scatter(
                x=t, y=np.round(bias, 5), name=axis, mode="lines", line={"color": colour, "width": 1.5}
            )
        )
    return drawn
