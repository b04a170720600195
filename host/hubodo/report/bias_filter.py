"""What a node's own filter said of its gyro, as words, a table and a figure."""

from __future__ import annotations

import math

import numpy as np

from hubodo.ingest.node.bias_filter import describe_filter_row
from hubodo.recording import Table
from hubodo.report.curves import Curve, curves
from hubodo.report.drawing import Drawing
from hubodo.report.page import COLOURS, Section
from hubowire.messages import FilterState

_DEG = math.degrees(1.0)
_AXES = {"x": COLOURS["left"], "y": COLOURS["right"], "z": COLOURS["fused"]}


def bias_filter_section(node: str, table: Table) -> tuple[Section | None, str]:
    """The node's estimate over time with its sigma, and the finding in one line; None without a bias.

    table: as in `Recording.bias_filters`.
    """
    known = table["state"] == FilterState.TRACKING
    if not known.any():
        return None, f"{node}: its own filter never had a bias: no initialisation, and none in its settings"
    last = {name: float(table[name][known][-1]) for name in table}
    fact = f"{node}: its own filter's bias, at the end {describe_filter_row(last)}"
    text = (
        "Each axis with 1 sigma of the initial bias where the node knows it. Rate and bias are seen only as "
        "their sum: what an axis follows beyond its initialisation and the warm-up rests on the node's gains."
    )
    return Section(f"{node}: bias by its own filter", text, figures=[_drawn(table, known)]), fact


def _drawn(table: Table, known: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Drawing:
    shown = []
    for axis, colour in _AXES.items():
        bias, sigma = (table[f"{what}_{axis}"][known] * _DEG for what in ("bias", "sigma"))
        shown.append(Curve(table.t[known], bias, axis, colour, sigma=np.nan_to_num(sigma)))
    return curves(shown, "time, s", "bias, °/s")
