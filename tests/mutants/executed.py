"""Line coverage by test with durations, recorded once and again for changed files."""

from __future__ import annotations

import ast
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from gap_matrix.judge.resumed import Row, read_rows
from mutants.core import digest
from mutants.operators import Mutant
from mutants.project_copy import ROOT, ProjectCopy

_FILES_PER_PROCESS = 6
"""Number of test files recorded by one process; an interruption loses up to this many."""
_TIME_LIMIT_S = 24 * 3600.0


def record_coverage(
    path: Path,
    files: Sequence[str],
    copy: Callable[[], ProjectCopy],
    report_progress: Callable[[int, int], None],
) -> list[Row]:
    """Return a row for each test file, see `recorder.py`, from an earlier run if it is current.

    path: file of the rows
    report_progress: called with the number of recorded files and the number of missing ones
    """
    rows = [row for row in read_rows(path) if _is_current(row)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(json.dumps(row, separators=(",", ":")) + "\n" for row in rows), "utf-8")
    finished = {row["key"] for row in rows}
    missing = [file for file in files if file not in finished]
    for index in range(0, len(missing), _FILES_PER_PROCESS):
        batch = missing[index : index + _FILES_PER_PROCESS]
        # Coverage measurement slows tests down.
        arguments = ["-p", "mutants.recorder", "-o", "timeout=1800", *batch]
        copy().pytest(arguments, _TIME_LIMIT_S, MUTANTS_ROWS=str(path))
        report_progress(index + len(batch), len(missing))
    return [row for row in read_rows(path) if row["key"] in files]


def _is_current(row: Row) -> bool:
    """Return True if no file of a row has changed since it was recorded."""
    return all(digest(ROOT / path) == recorded_digest for path, recorded_digest in row["digests"].items())


class LineCoverage:
    """The tests that execute each line of the core."""

    def __init__(self, rows: Iterable[Row]) -> None:
        self._by_path: dict[str, list[tuple[set[int], dict[str, float]]]] = {}
        for row in rows:
            tests = list(row["tests"].items())
            for path, groups in row["lines"].items():
                for numbers, lines in groups:
                    seconds_by_test = dict(tests[index] for index in numbers)
                    self._by_path.setdefault(path, []).append((set(lines), seconds_by_test))

    def tests_of(self, mutant: Mutant) -> dict[str, float]:
        """Return the duration in s of each test that executes the changed line, by test id.

        Code that runs on import counts as executed by all tests that execute any function of the file.
        """
        source = (ROOT / mutant.path).read_text("utf-8")
        lines = _find_changed_lines(ast.parse(source), mutant.line)
        return {
            test: seconds
            for executed_lines, seconds_by_test in self._by_path.get(mutant.path, ())
            if executed_lines & lines
            for test, seconds in seconds_by_test.items()
        }


def _find_changed_lines(tree: ast.Module, line: int) -> set[int]:
    """Return the lines of the innermost statement or lambda with a line; of all functions if in none."""
    nodes = list(ast.walk(tree))
    functions = [_function_lines(node) for node in nodes if isinstance(node, ast.FunctionDef | ast.Lambda)]
    if not any(line in body for body in functions):
        return {number for body in functions for number in body}
    line_ranges = [_statement_lines(node) for node in nodes if isinstance(node, ast.stmt | ast.Lambda)]
    return set(min((line_range for line_range in line_ranges if line in line_range), key=len))


def _function_lines(function: ast.FunctionDef | ast.Lambda) -> range:
    first = function.body[0] if isinstance(function, ast.FunctionDef) else function
    return range(first.lineno, (function.end_lineno or first.lineno) + 1)


def _statement_lines(node: ast.stmt | ast.Lambda) -> range:
    """Return the lines of a statement without the statements in its body."""
    body = getattr(node, "body", None)
    last = body[0].lineno - 1 if isinstance(body, list) and body else node.end_lineno or node.lineno
    return range(node.lineno, max(last, node.lineno) + 1)
