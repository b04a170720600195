"""Resumable long runs: rows in a file of JSON lines; missing rows are computed in parallel processes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, TypeVar

Row = dict[str, Any]
Item = TypeVar("Item")


def compute_rows(
    path: Path,
    items: Sequence[Item],
    key: Callable[[Item], str],
    compute_row: Callable[[Item], Row],
    jobs: int,
    report_progress: Callable[[int, int, Row], None] = lambda finished, total, row: None,
) -> list[Row]:
    """Return the row of each item, in the order of the items.

    path: file of finished rows, each with its `key`
    key: returns the key of an item
    compute_row: computes a row; a picklable function if `jobs` is above 1
    report_progress: called after each computed row with its number, the number of missing rows, and the row
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    finished = {row["key"]: row for row in read_rows(path)}
    missing = [item for item in items if key(item) not in finished]
    with path.open("a", encoding="utf-8") as file:
        for index, row in enumerate(_compute_missing(missing, compute_row, jobs)):
            finished[row["key"]] = row
            print(json.dumps(row), file=file, flush=True)
            report_progress(index + 1, len(missing), row)
    return [finished[key(item)] for item in items]


def read_rows(path: Path) -> list[Row]:
    """Return the rows of an earlier run; an incomplete last line is removed from the file."""
    if not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        path.write_text("".join(lines[:-1]), encoding="utf-8")
        lines = lines[:-1]
    return [json.loads(line) for line in lines]


def _compute_missing(missing: Sequence[Item], compute_row: Callable[[Item], Row], jobs: int) -> Iterator[Row]:
    """Yield the rows of the missing items as they are finished."""
    if jobs == 1:
        yield from map(compute_row, missing)
        return
    with ProcessPoolExecutor(jobs) as pool:
        for row in as_completed([pool.submit(compute_row, item) for item in missing]):
            yield row.result()
