"""Figures drawn once, by matplotlib: as SVG within a page, as a file of their own in PNG, SVG or PDF."""

from __future__ import annotations

import argparse
import html
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.atomic_files import atomic_files
from hubodo.errors import InputError

_SUFFIXES = (".png", ".svg", ".pdf")
_MISSING = "a figure needs matplotlib, which cannot be loaded here: pip install 'matplotlib>=3.8'"


@dataclass(frozen=True)
class Drawing:
    """A figure as it stands in a page; html: an SVG element, or one line that says why there is none."""

    html: str


def drawing_path(text: str) -> Path:
    """Value of an option that writes a figure: its suffix says the form."""
    if Path(text).suffix.lower() not in _SUFFIXES:
        raise argparse.ArgumentTypeError(f"{text}: name a file that ends in {', '.join(_SUFFIXES)}")
    return Path(text)


def blank(width_inches: float, height_inches: float) -> Any:
    """A matplotlib figure that needs no screen. Raises InputError where matplotlib cannot be loaded."""
    # Imported here: half a second that only those who want a picture pay.
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise InputError(_MISSING) from None
    figure = Figure(figsize=(width_inches, height_inches), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def drawing(draw: Callable[[], Any]) -> Drawing:
    """The matplotlib figure that draw() returns, for a page.

    Where matplotlib cannot be loaded the page is not lost: it says what to install instead.
    """
    try:
        return Drawing(svg(draw()))
    except InputError as error:
        return Drawing(f'<p class="dim">{html.escape(str(error))}</p>')


def save(figure: Any, path: Path) -> None:
    """Write a matplotlib figure in the form of its suffix. Raises OSError where it cannot be written."""
    with atomic_files(path) as (part,):
        figure.savefig(part, dpi=150, format=path.suffix[1:].lower())


def svg(figure: Any) -> str:
    """The SVG element alone; words stay words, which is small and can be searched."""
    import matplotlib as mpl

    out = io.StringIO()
    size = figure.get_size_inches()
    # Names within an element must differ from figure to figure of a page, and not from run to run.
    salt = repr([axes.get_ylabel() + axes.get_title() for axes in figure.axes])
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": salt, "font.family": "sans-serif"}):
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    body = text[text.index("<svg") :]
    head, rest = body.split(">", 1)
    return f'<svg viewBox="0 0 {72 * size[0]:g} {72 * size[1]:g}" role="img"{_kept(head)}>{rest}'


def _kept(head: str) -> str:
    """The name spaces of an SVG's first tag; its size in points is left to the page."""
    return "".join(f" {word}" for word in head.split() if word.startswith("xmlns"))
