"""Page section of the bias filter that runs on a node."""

from __future__ import annotations

import math

import numpy as np

from hubodo.ingest.node.bias_filter import describe_filter_row
from hubodo.pages.curves import Curve, draw_curves
from hubodo.pages.drawing import Drawing
from hubodo.pages.page import COLOURS, Section
from hubodo.recording import Table
from hubowire.messages import FilterState

_DEG = math.degrees(1.0)
_AXIS_COLOURS = {"x": COLOURS["left"], "y": COLOURS["right"], "z": COLOURS["fused"]}


def bias_filter_section(node: str, table: Table) -> tuple[Section | None, str]:
    """Return the section of a node's bias estimate, or None without one, and the finding in one line.

    table: as in `Recording.bias_filters`.
    """
    tracking = table["state"] == FilterState.TRACKING
    if not tracking.any():
        return None, f"{node}: the node's bias filter was never initialised, and its settings hold no bias"
    last = {name: float(table[name][tracking][-1]) for name in table}
    finding = f"{node}: bias of the node's own filter at the end: {describe_filter_row(last)}"
    text = (
        "Bias of each axis with the sigma (1σ) of its initial value, if known to the node. Only the sum of "
        "rate and "
        "bias is observable: changes beyond initialisation and warm-up depend on the gains of the node's "
        "filter."
    )
    return Section(
        f"{node}: bias of the node's own filter", text, figures=[_plot_bias(table, tracking)]
    ), finding


def _plot_bias(table: Table, tracking: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Drawing:
    plotted = []
    for axis, colour in _AXIS_COLOURS.items():
        bias, sigma = (table[f"{quantity}_{axis}"][tracking] * _DEG for quantity in ("bias", "sigma"))
        plotted.append(Curve(table.t[tracking], bias, axis, colour, sigma=np.nan_to_num(sigma)))
    return draw_curves(plotted, "time, s", "bias, °/s")
