"""Texts as HTML tables and paragraphs, for pages and notebooks."""

from __future__ import annotations

import html
from collections.abc import Sequence


def html_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table with a row of headings, then the rows."""
    head = "".join(f"<th>{html.escape(text)}</th>" for text in headings)
    lines = ("".join(f"<td>{html.escape(text)}</td>" for text in row) for row in rows)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def html_lines(lines: Sequence[str]) -> str:
    """Return a paragraph for each line."""
    return "".join(f"<p>{html.escape(line)}</p>" for line in lines)
