"""Progress of a long verb on stderr: a bar on a terminal, else a line every ten seconds."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from hubodo.terminal import SafeConsole

# Seconds between two lines if stderr is not a terminal.
_LINE_INTERVAL = 10.0


@contextmanager
def progress_line() -> Iterator[Callable[[str, float], None]]:
    """Yield a function `show(text, fraction)` that updates a bar, or prints lines where stderr is a file."""
    if not sys.stderr.isatty():
        yield _show_lines()
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


def _show_lines() -> Callable[[str, float], None]:
    """Return a function `show(text, fraction)` that prints a line every ten seconds, the first after ten."""
    last = time.monotonic()

    def show(text: str, fraction: float) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= _LINE_INTERVAL:
            last = now
            print(f"{100.0 * fraction:3.0f} %  {text}", file=sys.stderr, flush=True)

    return show
