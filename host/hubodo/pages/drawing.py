"""Matplotlib figures as SVG within a page, or as PNG, SVG or PDF files."""

from __future__ import annotations

import argparse
import html
import io
import re
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.atomic_files import atomic_files
from hubodo.errors import InputError

_FIGURE_SUFFIXES = (".png", ".svg", ".pdf")
_MATPLOTLIB_MISSING = "a figure needs matplotlib, which cannot be loaded here: pip install 'matplotlib>=3.8'"


_LEGEND_POINTS = 8.5
"""Font size of legends, points; a character is about 0.6 and the line before it 4.5 times as wide."""
_NARROW_WIDTH_IN, _NARROW_HEIGHT_RATIO = 4.4, 0.9
"""Size of a figure for a phone: inches, and share of the height of the wide one."""
_NARROW_CHARACTERS = 40
"""Longest line of a title or label in it."""
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


def add_legend_above(figure: Any) -> None:
    """Add or renew the legend of all labelled artists above the axes of a figure, where it hides no data."""
    by_label: dict[str, Any] = {}
    for axes in figure.axes:
        handles, labels = axes.get_legend_handles_labels()
        by_label = {**dict(zip(labels, handles, strict=True)), **by_label}
    for legend in tuple(figure.legends):
        legend.remove()
    if not by_label:
        return
    widest = _LEGEND_POINTS * (0.6 * max(map(len, by_label)) + 4.5)
    columns = max(1, min(len(by_label), int(72.0 * figure.get_figwidth() / widest)))
    figure.legend(
        list(by_label.values()),
        list(by_label),
        loc="outside upper left",
        ncols=columns,
        fontsize=_LEGEND_POINTS,
        frameon=False,
    )


def render_drawing(draw: Callable[[], Any]) -> Drawing:
    """Return the matplotlib figure made by draw() as a drawing for a page, for wide and for narrow screens.

    If matplotlib cannot be loaded, the drawing is a line that says what to install.
    """
    try:
        figure = draw()
    except InputError as error:
        return Drawing(f'<p class="dim">{html.escape(str(error))}</p>')
    wide = figure_to_svg(figure)
    _make_narrow(figure)
    return Drawing(
        f'<div class="on-wide">{_follow_page_colours(wide)}</div>'
        f'<div class="on-narrow">{_follow_page_colours(figure_to_svg(figure))}</div>'
    )


def _make_narrow(figure: Any) -> None:
    """Resize a figure for a phone, where its text would otherwise shrink with it."""
    width, height = figure.get_size_inches()
    figure.set_size_inches(min(width, _NARROW_WIDTH_IN), height * _NARROW_HEIGHT_RATIO)
    figure.set_layout_engine("constrained")
    for axes in figure.axes:
        axes.set_xlabel(textwrap.fill(axes.get_xlabel(), _NARROW_CHARACTERS))
        axes.set_title(textwrap.fill(axes.get_title(), _NARROW_CHARACTERS))
    if figure.legends:
        add_legend_above(figure)


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
    salt = repr([float(size[0]), *(axes.get_ylabel() + axes.get_title() for axes in figure.axes)])
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
