"""Tables and lines of results on a terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def print_table(
    console: Console, headings: Sequence[str], rows: Iterable[Sequence[str]], title: str | None = None
) -> None:
    """Print a table with a row of headings, if there are any, then the rows."""
    from rich.table import Table  # here, because the Python interface has results without a terminal

    table = Table(*headings, title=title, show_header=bool(headings))
    for row in rows:
        table.add_row(*row)
    console.print(table)


def print_lines(console: Console, lines: Iterable[str], *, label: str = "") -> None:
    """Print lines without highlighting numbers, each after a label, such as `note`."""
    for line in lines:
        console.print(f"{label}: {line}" if label else line, highlight=False)


def print_text(console: Console, text: str) -> None:
    """Print text as it is: without markup and highlighted numbers, its long lines unbroken."""
    console.print(text, highlight=False, markup=False, soft_wrap=True)
