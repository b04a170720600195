"""A figure that notebooks display and that can be saved."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hubodo.api.arguments import StrPath
from hubodo.errors import InputError
from hubodo.report.curves import Curve, plot_curves
from hubodo.report.drawing import figure_to_svg, parse_drawing_path, save_figure
from hubodo.report.page import COLOURS

if TYPE_CHECKING:
    from hubodo.api.log import LoadedLog

_CURVE_COLOURS = ("#1b6ca8", "#d1495b", "#2e7d5b", "#7a4fa3", "#8a6d3b", "#1d2126")


class Plot:
    """A matplotlib figure; a notebook displays it if it is the value of the last line of a cell.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.

    Attributes
    ----------
    figure : matplotlib.figure.Figure
        The figure, for further changes.
    """

    def __init__(self, figure: Any) -> None:
        self.figure = figure

    def save(self, path: StrPath) -> Path:
        """Write the figure as .png, .svg or .pdf.

        Parameters
        ----------
        path : str or path-like
            The file; its suffix gives the format.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            If the suffix is another one.
        """
        try:
            target = parse_drawing_path(str(path))
        except argparse.ArgumentTypeError as error:
            raise InputError(str(error)) from None
        save_figure(self.figure, target)
        return target

    def _repr_html_(self) -> str:
        return f'<div style="max-width: 50rem; background: #ffffff">{figure_to_svg(self.figure)}</div>'

    def __repr__(self) -> str:
        titles = (axes.get_title() or axes.get_ylabel() for axes in self.figure.axes)
        return f"Plot({', '.join(title for title in titles if title)})"


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
