"""Matplotlib figures as SVG within a page, or as PNG, SVG or PDF files."""

from __future__ import annotations

import argparse
import html
import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.atomic_files import atomic_files
from hubodo.errors import InputError

_FIGURE_SUFFIXES = (".png", ".svg", ".pdf")
_MATPLOTLIB_MISSING = "a figure needs matplotlib, which cannot be loaded here: pip install 'matplotlib>=3.8'"


_COLOUR_IN_STYLE = re.compile(r"\b(fill|stroke): #([0-9a-f]{6})")
DARK_COLOURS = {
    "000000": "#e6e8ea",
    "1d2126": "#e6e8ea",
    "ffffff": "#16191d",
    "d8dce0": "#3a4047",
    "b0b0b0": "#3a4047",
    "cccccc": "#4a5057",
    "5d646c": "#9aa2aa",
    "1b6ca8": "#62aee8",
    "d1495b": "#f0808f",
    "2e7d5b": "#5fc294",
    "7a4fa3": "#b48be0",
    "7d3c98": "#c08ad8",
    "8e5ea2": "#c49ad6",
    "4a6a8a": "#8fb0d0",
    "5d5480": "#a79fd0",
    "8a6d3b": "#c9a86a",
    "0e7490": "#4bb8d4",
    "a66a00": "#e0a340",
    "c2570c": "#f08a48",
}
"""Colour of a figure on a dark page, for each colour that would be too dark there."""


@dataclass(frozen=True)
class Drawing:
    """A figure in a page; html: an SVG element, or one line with the reason why there is none."""

    html: str


def parse_drawing_path(text: str) -> Path:
    """Parse the value of an option that names a figure file, whose suffix selects the format."""
    if Path(text).suffix.lower() not in _FIGURE_SUFFIXES:
        raise argparse.ArgumentTypeError(f"{text}: name a file that ends in {', '.join(_FIGURE_SUFFIXES)}")
    return Path(text)


def new_figure(width_inches: float, height_inches: float) -> Any:
    """Return an empty matplotlib figure that needs no display; raise InputError without matplotlib."""
    # Imported here, because it takes half a second that only figures should cost.
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise InputError(_MATPLOTLIB_MISSING) from None
    figure = Figure(figsize=(width_inches, height_inches), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def add_legend_above(axes: Any, *, columns: int = 4) -> None:
    """Add the legend of axes above all axes of their figure, where it hides no data."""
    handles, labels = axes.get_legend_handles_labels()
    axes.figure.legend(
        handles, labels, loc="outside upper left", ncols=columns, fontsize=8, frameon=False, markerscale=2.0
    )


def render_drawing(draw: Callable[[], Any]) -> Drawing:
    """Return the matplotlib figure made by draw() as a drawing for a page.

    If matplotlib cannot be loaded, the drawing is a line that says what to install.
    """
    try:
        return Drawing(_follow_page_colours(figure_to_svg(draw())))
    except InputError as error:
        return Drawing(f'<p class="dim">{html.escape(str(error))}</p>')


def _follow_page_colours(svg: str) -> str:
    """Return an SVG whose colours are variables of the page, so that a dark page has dark figures."""
    return _COLOUR_IN_STYLE.sub(lambda match: f"{match[1]}: var(--c{match[2]}, #{match[2]})", svg)


def save_figure(figure: Any, path: Path) -> None:
    """Write a matplotlib figure in the format of its suffix; raise OSError if it cannot be written."""
    _fix_layout(figure)
    with atomic_files(path) as (part,):
        figure.savefig(part, dpi=150, format=path.suffix[1:].lower())


def figure_to_svg(figure: Any) -> str:
    """Return a figure as an SVG element; text remains text, which is small and searchable."""
    import matplotlib as mpl

    out = io.StringIO()
    size = figure.get_size_inches()
    # Element ids must differ between the figures of a page but be reproducible from run to run.
    salt = repr([axes.get_ylabel() + axes.get_title() for axes in figure.axes])
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": salt, "font.family": "sans-serif"}):
        _fix_layout(figure)
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    body = text[text.index("<svg") :]
    head, body_after_tag = body.split(">", 1)
    return (
        f'<svg viewBox="0 0 {72 * size[0]:g} {72 * size[1]:g}" role="img"{_namespaces(head)}>{body_after_tag}'
    )


def _fix_layout(figure: Any) -> None:
    """Place the axes of a figure once; with a layout engine, each file would be drawn twice."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)


def _namespaces(head: str) -> str:
    """Return the namespaces of an SVG's first tag, without its size, which the page sets."""
    return "".join(f" {word}" for word in head.split() if word.startswith("xmlns"))
