"""The plot of a channel of a log over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hubodo.errors import InputError
from hubodo.pages.curves import Curve, plot_curves
from hubodo.pages.page import COLOURS
from hubodo.pages.plot import Plot

if TYPE_CHECKING:
    from hubodo.api.log import LoadedLog

_CURVE_COLOURS = ("#1b6ca8", "#d1495b", "#2e7d5b", "#7a4fa3", "#8a6d3b", "#1d2126")


def plot_channel(log: LoadedLog, channel: str) -> Plot:
    """Plot a channel of all nodes over time; see `LoadedLog.plot`."""
    curves = [
        Curve(table.t, table[channel], name, COLOURS.get(name, _CURVE_COLOURS[k % len(_CURVE_COLOURS)]), 1.0)
        for k, (name, table) in enumerate(log.nodes.items())
        if channel in table
    ]
    if not curves:
        raise InputError(f"{log.path}: no node has a column {channel!r}")
    unit = {"g": "rad/s", "a": "m/s²"}.get(channel[0], "") if len(channel) == 2 else ""
    return Plot(plot_curves(curves, "time, s", f"{channel}, {unit}" if unit else channel))
