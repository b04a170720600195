"""Curves over one axis as a drawing for a page, with bands of one sigma and a second scale where wanted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from hubodo.report.drawing import Drawing, blank, drawing

Values = NDArray[Any]
_POINTS = 2000
"""Drawn of each curve; more cannot be told apart on a screen."""
_WIDTH = 9.0
"""Inches; a page shows it as wide as it is itself."""


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve.

    x, y: (N,). width: in points, 0: the band alone. sigma: (N,) half the width of a band about it. dots:
    marks instead of a line.
    """

    x: Values
    y: Values
    name: str
    colour: str
    width: float = 1.3
    sigma: Values | None = None
    dots: bool = False


Scale = tuple[str, Sequence[Curve]]
"""Label and curves of a second scale."""


def curves(
    shown: Sequence[Curve],
    x_label: str,
    y_label: str,
    *,
    height: float = 3.2,
    equal: bool = False,
    right: Scale | None = None,
) -> Drawing:
    """`curves_figure` for a page."""
    return drawing(lambda: curves_figure(shown, x_label, y_label, height=height, equal=equal, right=right))


def curves_figure(
    shown: Sequence[Curve],
    x_label: str,
    y_label: str,
    *,
    height: float = 3.2,
    equal: bool = False,
    right: Scale | None = None,
) -> Any:
    """A matplotlib figure; height: inches; equal: both axes to one scale, as a map; right: a second scale.

    Raises InputError where matplotlib cannot be loaded.
    """
    figure = blank(_WIDTH, height)
    axes = figure.subplots()
    scales = [(axes, y_label, shown)]
    if right is not None:
        scales.append((axes.twinx(), *right))
    for scale, label, some in scales:
        for curve in some:
            _curve(scale, curve)
        scale.set_ylabel(label)
    axes.set_xlabel(x_label)
    axes.grid(True, lw=0.3, color="#d8dce0")
    if equal:
        axes.set_aspect("equal", adjustable="datalim")
    handles = [handle for scale, _, _ in scales for handle in scale.get_legend_handles_labels()[0]]
    if len(handles) > 1:
        figure.legend(handles=handles, loc="outside upper left", ncols=6, fontsize=9, frameon=False)
    return figure


def _curve(axes: Any, curve: Curve) -> None:
    some = slice(None, None, max(1, len(curve.x) // _POINTS))
    x, y = curve.x[some], curve.y[some]
    form = {"ls": "", "marker": ".", "ms": 3} if curve.dots else {"lw": curve.width}
    if curve.sigma is not None:
        sigma, name = curve.sigma[some], None if curve.width else curve.name
        axes.fill_between(x, y - sigma, y + sigma, color=curve.colour, alpha=0.18, lw=0, label=name)
    if curve.width:
        axes.plot(x, y, color=curve.colour, label=curve.name, **form)
