"""Progress of a long verb: one line on stderr with the time left, only on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from hubodo.terminal import SafeConsole


@contextmanager
def progress_line() -> Iterator[Callable[[str, float], None]]:
    """Yield `show(text, fraction)`, which does nothing where stderr is no terminal."""
    if not sys.stderr.isatty():
        yield lambda text, fraction: None
        return
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        console=SafeConsole(stderr=True),
        transient=True,
    )
    with bar:
        task = bar.add_task("", total=1.0)
        yield lambda text, fraction: bar.update(task, description=text, completed=fraction)
