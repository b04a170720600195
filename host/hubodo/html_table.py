"""Texts as HTML tables and paragraphs, for pages and notebooks."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence

_NUMBER = re.compile(
    r"[-+−±<>≤≥]? ?[\d.][\d.,]*(e[-+]?\d+)?( ?%)?( ± [\d.e+-]+)?|\([-+\d.]+ ± [\d.]+\)e[-+]?\d+",
    re.IGNORECASE,
)
"""A number, with its sigma or a percent sign."""
_QUANTITY = re.compile(r"[-+−<>]? ?[\d.][\d.,e+-]*( ± [\d.e+-]+)? \S{1,12}")
"""A number with its unit, which stays on one line on a wide screen."""
_WIDE_COLUMNS = 5  # columns from which a narrow screen shows a row as lines of label and value
_WIDE_CHARACTERS = 60  # of a row, above which it does so with fewer columns


def html_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table of the rows below their headings, if any is not empty; text is left-aligned."""
    n_columns = max([len(headings), *map(len, rows)])
    kinds = [
        "number" if any(headings) and _is_numeric([row[k] for row in rows if k < len(row)]) else "text"
        for k in range(n_columns)
    ]
    is_wide = any(headings) and (n_columns >= _WIDE_COLUMNS or _is_long(rows))
    labels = [f' data-label="{html.escape(text)}"' if is_wide else "" for text in headings]
    labels += [""] * (n_columns - len(labels))
    head = "".join(
        f'<th class="{kind}">{html.escape(text)}</th>' for kind, text in zip(kinds, headings, strict=False)
    )
    lines = (
        "".join(
            f'<td class="{_cell_class(kind, text)}"{label}>{html.escape(text)}</td>'
            for kind, label, text in zip(kinds, labels, row, strict=False)
        )
        for row in rows
    )
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    top = f"<thead><tr>{head}</tr></thead>" if any(headings) else ""
    tag = '<table class="wide">' if is_wide else "<table>"
    return f"{tag}{top}<tbody>{body}</tbody></table>"


def _is_long(rows: Sequence[Sequence[str]]) -> bool:
    """Return True if at least three columns are together longer than a line of a narrow screen."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=False)]
    return len(widths) > 2 and sum(widths) > _WIDE_CHARACTERS


def _cell_class(kind: str, text: str) -> str:
    return f"{kind} quantity" if _QUANTITY.fullmatch(text) else kind


def _is_numeric(column: Sequence[str]) -> bool:
    """Return True for a column of numbers, which are right-aligned; empty cells do not count."""
    texts = [text for text in column if text.strip()]
    return bool(texts) and all(_NUMBER.fullmatch(text.strip()) for text in texts)


def html_lines(lines: Sequence[str]) -> str:
    """Return a paragraph for each line."""
    return "".join(f"<p>{html.escape(line)}</p>" for line in lines)
