"""Line plots for pages, with optional 1σ bands and a second y axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from hubodo.pages.drawing import Drawing, add_legend_above, new_figure, render_drawing

Values = NDArray[Any]
_MAX_CURVE_POINTS = 2000
"""Largest number of points plotted per curve."""
_FIGURE_WIDTH_IN = 9.0
"""Width of a figure, inches; a page scales it to its own width."""


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve of a plot.

    Attributes:
        x, y: (N,) coordinates.
        name: label in the legend.
        colour: colour of line and band.
        width: line width in points; 0 for the band only.
        sigma: (N,) half width of a band about the curve, or None.
        dots: True for markers instead of a line.
    """

    x: Values
    y: Values
    name: str
    colour: str
    width: float = 1.3
    sigma: Values | None = None
    dots: bool = False


Scale = tuple[str, Sequence[Curve]]
"""Label and curves of the second y axis."""


def draw_curves(
    plotted: Sequence[Curve],
    x_label: str,
    y_label: str,
    *,
    height: float = 3.2,
    equal: bool = False,
    right: Scale | None = None,
    from_zero: bool = False,
) -> Drawing:
    """Return the figure of `plot_curves` as a drawing for a page."""
    return render_drawing(
        lambda: plot_curves(
            plotted, x_label, y_label, height=height, equal=equal, right=right, from_zero=from_zero
        )
    )


def plot_curves(
    plotted: Sequence[Curve],
    x_label: str,
    y_label: str,
    *,
    height: float = 3.2,
    equal: bool = False,
    right: Scale | None = None,
    from_zero: bool = False,
) -> Any:
    """Return a matplotlib figure of curves.

    height: inches. equal: equal scale of both axes, as for a map. right: second y axis.
    from_zero: the y axis begins at 0. Raises InputError if
    matplotlib cannot be loaded.
    """
    figure = new_figure(_FIGURE_WIDTH_IN, height)
    axes = figure.subplots()
    scales = [(axes, y_label, plotted)]
    if right is not None:
        scales.append((axes.twinx(), *right))
    for scale, label, stride in scales:
        for curve in stride:
            _plot_curve(scale, curve)
        scale.set_ylabel(label)
    axes.set_xlabel(x_label)
    axes.grid(True, lw=0.3, color="#d8dce0")
    if all(curve.x.dtype.kind in "iu" for curve in plotted):
        axes.xaxis.get_major_locator().set_params(integer=True)
    if from_zero:
        axes.set_ylim(0.0, 1.05 * axes.dataLim.y1)
    if equal:
        axes.set_aspect("equal", adjustable="datalim")
    if sum(len(scale.get_legend_handles_labels()[0]) for scale, _, _ in scales) > 1:
        add_legend_above(figure)
    return figure


def _plot_curve(axes: Any, curve: Curve) -> None:
    stride = slice(None, None, max(1, len(curve.x) // _MAX_CURVE_POINTS))
    x, y = curve.x[stride], curve.y[stride]
    style = {"ls": "", "marker": ".", "ms": 6} if curve.dots else {"lw": curve.width}
    if curve.sigma is not None:
        sigma, name = curve.sigma[stride], None if curve.width else curve.name
        axes.fill_between(x, y - sigma, y + sigma, color=curve.colour, alpha=0.18, lw=0, label=name)
    if curve.width:
        axes.plot(x, y, color=curve.colour, label=curve.name, **style)
