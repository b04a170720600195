"""Resumable long runs: rows in a file of JSON lines; missing ones are computed in a few processes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, TypeVar

Row = dict[str, Any]
Item = TypeVar("Item")


def rows(
    path: Path,
    plan: Sequence[Item],
    key: Callable[[Item], str],
    make: Callable[[Item], Row],
    jobs: int,
    say: Callable[[int, int, Row], None] = lambda done, of, row: None,
) -> list[Row]:
    """Return the row of each item, in the order of the plan.

    path: where they are kept, each with its `key`. make: a function of a module, as processes need it. say:
        gets how many of those that were missing are made, and the last one.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    done = {row["key"]: row for row in kept(path)}
    missing = [item for item in plan if key(item) not in done]
    with path.open("a", encoding="utf-8") as file:
        for k, row in enumerate(_made(missing, make, jobs)):
            done[row["key"]] = row
            print(json.dumps(row), file=file, flush=True)
            say(k + 1, len(missing), row)
    return [done[key(item)] for item in plan]


def kept(path: Path) -> list[Row]:
    """Return the rows of an earlier run, without an incomplete last line."""
    if not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        path.write_text("".join(lines[:-1]), encoding="utf-8")
        lines = lines[:-1]
    return [json.loads(line) for line in lines]


def _made(missing: Sequence[Item], make: Callable[[Item], Row], jobs: int) -> Iterator[Row]:
    if jobs == 1:
        yield from map(make, missing)
        return
    with ProcessPoolExecutor(jobs) as pool:
        for row in as_completed([pool.submit(make, item) for item in missing]):
            yield row.result()
