"""Which tests execute a line, and how long each takes: recorded once, and anew where a file has changed."""

from __future__ import annotations

import ast
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from gap_matrix.judge.resumed import Row, kept
from mutants.core import digest
from mutants.operators import Mutant
from mutants.project_copy import ROOT, ProjectCopy

_AT_ONCE = 6
"""Test files recorded by one process: so many are lost where it is interrupted."""
_NO_LIMIT = 24 * 3600.0


def recorded(
    path: Path, files: Sequence[str], copy: Callable[[], ProjectCopy], say: Callable[[int, int], None]
) -> list[Row]:
    """A row for each test file, see `recorder.py`; those that an earlier run left in `path` where they hold.

    say: gets how many files are recorded, of how many that were missing.
    """
    rows = [row for row in kept(path) if _holds(row)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(json.dumps(row, separators=(",", ":")) + "\n" for row in rows), "utf-8")
    known = {row["key"] for row in rows}
    missing = [file for file in files if file not in known]
    for k in range(0, len(missing), _AT_ONCE):
        some = missing[k : k + _AT_ONCE]
        # Under observation tests are slow.
        arguments = ["-p", "mutants.recorder", "-o", "timeout=1800", *some]
        copy().pytest(arguments, _NO_LIMIT, MUTANTS_ROWS=str(path))
        say(k + len(some), len(missing))
    return [row for row in kept(path) if row["key"] in files]


def _holds(row: Row) -> bool:
    return all(digest(ROOT / path) == said for path, said in row["digests"].items())


class Executed:
    """Of each line of the core, the tests that execute it."""

    def __init__(self, rows: Iterable[Row]) -> None:
        self._by_path: dict[str, list[tuple[set[int], dict[str, float]]]] = {}
        for row in rows:
            tests = list(row["tests"].items())
            for path, groups in row["lines"].items():
                for numbers, lines in groups:
                    who = dict(tests[k] for k in numbers)
                    self._by_path.setdefault(path, []).append((set(lines), who))

    def tests_of(self, mutant: Mutant) -> dict[str, float]:
        """Seconds of each test that executes what the mutant changes, by the test's id.

        What is done on import is executed by all tests that execute anything in a function of the file.
        """
        source = (ROOT / mutant.path).read_text("utf-8")
        lines = _lines_of(ast.parse(source), mutant.line)
        return {
            test: seconds
            for executed, who in self._by_path.get(mutant.path, ())
            if executed & lines
            for test, seconds in who.items()
        }


def _lines_of(tree: ast.Module, line: int) -> set[int]:
    """Those of the statement or lambda that holds a line; of all functions where it stands in none."""
    nodes = list(ast.walk(tree))
    functions = [_body(node) for node in nodes if isinstance(node, ast.FunctionDef | ast.Lambda)]
    if not any(line in body for body in functions):
        return {number for body in functions for number in body}
    parts = [_own_lines(node) for node in nodes if isinstance(node, ast.stmt | ast.Lambda)]
    return set(min((part for part in parts if line in part), key=len))


def _body(function: ast.FunctionDef | ast.Lambda) -> range:
    first = function.body[0] if isinstance(function, ast.FunctionDef) else function
    return range(first.lineno, (function.end_lineno or first.lineno) + 1)


def _own_lines(node: ast.stmt | ast.Lambda) -> range:
    """Without the statements in it."""
    body = getattr(node, "body", None)
    last = body[0].lineno - 1 if isinstance(body, list) and body else node.end_lineno or node.lineno
    return range(node.lineno, max(last, node.lineno) + 1)
