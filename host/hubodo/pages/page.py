"""Self-contained HTML pages of text, tables and figures that open without a network.

A figure is a `Drawing` (some tens of kB) or a zoomable plotly figure, of which the first one adds 4.8 MB
to the page.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hubodo.html_table import html_table
from hubodo.pages.drawing import DARK_COLOURS, Drawing

if TYPE_CHECKING:
    import plotly.graph_objects as go

# The three hues also differ in lightness, so that they are distinguishable in grey and by colour-blind
# readers.
COLOURS = {"left": "#1b6ca8", "right": "#d1495b", "truth": "#8a8d91", "fused": "#2e7d5b", "frame": "#8a8d91"}

_PAGE_STYLE = """
:root { color-scheme: light dark; --ink: #1d2126; --dim: #5d646c; --line: #d8dce0; --paper: #ffffff; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6e8ea; --dim: #9aa2aa; --line: #3a4047; --paper: #16191d; %s }
}
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
  max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; margin-bottom: 0.2rem; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
p.lead { font-size: 1.1rem; } p { color: var(--ink); } .dim { color: var(--dim); }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 0.25rem 0.9rem 0.25rem 0; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child, th.text, td.text { text-align: left; } td.number { white-space: nowrap; }
@media (min-width: 40rem) { td.quantity { white-space: nowrap; } }
@media screen and (min-width: 40rem) { table.wide { font-size: 0.92rem; } }
details { margin-top: 1rem; border-top: 1px solid var(--line); } details h2 { margin-top: 1rem; }
summary { cursor: pointer; padding: 0.5rem 0; } summary h2 { display: inline; margin: 0; }
@media (max-width: 40rem) { body { margin: 1rem auto; } table { font-size: 0.85rem; }
  th, td { padding-right: 0.6rem; }
  .on-wide, .modebar { display: none; }
  table.wide, table.wide tbody { display: block; } table.wide thead { display: none; }
  table.wide tr { display: flex; flex-wrap: wrap; gap: 0 0.9rem; padding: 0.35rem 0;
    border-bottom: 1px solid var(--line); }
  table.wide td { border: 0; padding: 0; text-align: left; white-space: normal; }
  table.wide td:empty { display: none; }
  table.wide td::before { content: attr(data-label) " "; color: var(--dim); }
  table.wide td:first-child { font-weight: 600; flex-basis: 100%%; }
  table.wide td:first-child::before { content: ""; }
}
@media (min-width: 40.01rem) { .on-narrow { display: none; } }
@media print { details > * { display: block; } }
th { color: var(--dim); font-weight: 600; }
ul.todo { padding-left: 1.2rem; } ul.todo li { margin: 0.3rem 0; }
.figure svg { display: block; width: 100%%; height: auto; } .figure svg text { fill: var(--ink); }
.figure p { color: var(--dim); margin: 0.5rem; }
.figure { margin-top: 0.8rem; background: var(--paper); border: 1px solid var(--line);
  border-radius: 6px; padding: 4px; }
pre { font-size: 0.85rem; border: 1px solid var(--line); border-radius: 6px; padding: 0.8rem;
  overflow-x: auto; }
"""
_SHEET_STYLE = """
@page { size: A4; margin: 11mm; }
@media print {
  body { font-size: 9px; line-height: 1.3; max-width: none; margin: 0; padding: 0; color-scheme: light; }
  h1 { font-size: 16px; margin: 0; } h2 { font-size: 11px; margin: 7px 0 1px; break-after: avoid; }
  h2.side { break-before: page; }
  p { margin: 1px 0; } p.lead { font-size: 9px; } th, td { padding: 0 6px 0 0; }
  .figure { border: 0; margin: 0; padding: 0; } .figure svg { height: 86mm; }
  .on-wide { display: block; } .on-narrow { display: none; } pre { font-size: 8px; padding: 4px; }
}
"""
_DARK_VARIABLES = " ".join(f"--c{light}: {dark};" for light, dark in DARK_COLOURS.items())
_ADAPT_PLOTLY = """
<script>if (matchMedia("(max-width: 40rem)").matches) {
  const look = { "legend.yanchor": "bottom", "legend.y": 1.02, "font.size": 10 };
  Object.assign(look, { "margin.l": 48, "margin.r": 8 });
  document.querySelectorAll(".plotly-graph-div").forEach((plot) => {
    for (const axis of Object.keys(plot.layout).filter((name) => /^[xy]axis/.test(name))) {
      look[axis + ".title.font.size"] = 10;
    }
    Plotly.relayout(plot, look);
  });
}
if (matchMedia("(prefers-color-scheme: dark)").matches) {
  document.querySelectorAll(".plotly-graph-div").forEach((plot) => {
    const axes = Object.keys(plot.layout).filter((name) => /^[xy]axis/.test(name));
    const look = { "font.color": "#e6e8ea", paper_bgcolor: "#16191d", plot_bgcolor: "#16191d" };
    for (const axis of axes) { look[axis + ".gridcolor"] = look[axis + ".zerolinecolor"] = "#3a4047"; }
    Plotly.relayout(plot, look);
  });
}</script>"""
"""Plotly has no colours of the page and no layout for phones; both are set when the page is opened."""


@dataclass(frozen=True)
class PageTable:
    """A table of text with one row of headings."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Section:
    """A section of a page: title, text, advice, tables, figures, and `listing` (preformatted text).

    is_folded: the reader opens it by a click on its title. starts_page: it begins a side of a printed sheet.
    """

    title: str
    text: str = ""
    tables: Sequence[PageTable] = ()
    figures: Sequence[go.Figure | Drawing] = ()
    listing: str = ""
    advice: Sequence[str] = ()
    is_folded: bool = False
    starts_page: bool = False


def new_plotly_figure(x_title: str, y_title: str, *, height: int = 320, equal: bool = False) -> go.Figure:
    """Return an empty plotly figure in the style of the pages.

    `equal`: equal scale of both axes, as for maps.
    """
    import plotly.graph_objects as go

    drawing_or_plot = go.Figure()
    drawing_or_plot.update_layout(
        template="plotly_white",
        height=height,
        margin={"l": 60, "r": 20, "t": 20, "b": 50},
        xaxis_title=x_title,
        yaxis_title=y_title,
        legend={"orientation": "h", "y": 1.08, "x": 0.0},
    )
    if equal:
        drawing_or_plot.update_yaxes(scaleanchor="x", scaleratio=1.0)
    return drawing_or_plot


def _grid(grid: PageTable) -> str:
    return f'<div class="scroll">{html_table(grid.headings, grid.rows)}</div>'


def _figure(drawing_or_plot: go.Figure | Drawing, name: str) -> str:
    if isinstance(drawing_or_plot, Drawing):
        return f'<div class="figure">{drawing_or_plot.html}</div>'
    import plotly.io

    # An explicit id, because plotly's default id differs from run to run.
    drawn = plotly.io.to_html(
        drawing_or_plot, include_plotlyjs=False, full_html=False, config={"displaylogo": False}, div_id=name
    )
    return f'<div class="figure">{drawn}</div>'


def render_page(
    title: str, lead: str, sections: Sequence[Section], hero: str = "", *, is_sheet: bool = False
) -> str:
    """Return a page as HTML: a title, one sentence with the result, then the sections.

    hero: HTML (inserted without escaping) between that sentence and the sections. is_sheet: printed, it is a
    sheet of A4 in small type.
    """
    parts = [f"<h1>{html.escape(title)}</h1>", f'<p class="lead">{html.escape(lead)}</p>', hero]
    for number, section in enumerate(sections, 1):
        mark = ' class="side"' if section.starts_page else ""
        heading = f"<h2{mark}>{html.escape(section.title)}</h2>"
        parts.append(f"<details><summary>{heading}</summary>" if section.is_folded else heading)
        if section.text:
            parts.append(f"<p>{html.escape(section.text)}</p>")
        if section.advice:
            lines = "".join(f"<li>{html.escape(line)}</li>" for line in section.advice)
            parts.append(f'<ul class="todo">{lines}</ul>')
        parts += [_grid(grid) for grid in section.tables]
        parts += [
            _figure(drawing_or_plot, f"figure-{number}-{at}")
            for at, drawing_or_plot in enumerate(section.figures, 1)
        ]
        if section.listing:
            parts.append(f"<pre>{html.escape(section.listing)}</pre>")
        if section.is_folded:
            parts.append("</details>")
    plotly = _plotly(sections)
    parts.append(_ADAPT_PLOTLY if plotly else "")
    style = _PAGE_STYLE % _DARK_VARIABLES + (_SHEET_STYLE if is_sheet else "")
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{style}</style>{plotly}</head><body>{''.join(parts)}</body></html>\n"
    )


def _plotly(sections: Sequence[Section]) -> str:
    """Return the plotly script if the page has plotly figures, otherwise an empty string."""
    if all(
        isinstance(drawing_or_plot, Drawing) for section in sections for drawing_or_plot in section.figures
    ):
        return ""
    from plotly.offline import get_plotlyjs

    return f"<script>{get_plotlyjs()}</script>"
