"""A pytest plugin that records the lines of the core executed by each test, and its CPU time.

It appends a row for each test file to the JSON lines `MUTANTS_ROWS`: `tests`, the passed tests with their CPU
time; `lines`, for each file of the core, groups of test numbers with the lines that exactly these tests
execute; `digests` of all files concerned. Lines executed by fixtures count for all tests of a file, as they
may share fixtures; so do all lines if the test file has cached functions of its own.
"""

from __future__ import annotations

import functools
import json
import os
import sys
from collections import defaultdict
from pathlib import Path

import coverage

from mutants.core import CORE, digest

ROOT = Path.cwd()
_coverage = coverage.Coverage(
    data_file=None, config_file=False, source=[str(ROOT / f) for f in CORE.values()]
)
_seconds: dict[str, float] = {}
_failed: set[str] = set()


def pytest_configure():
    _coverage.start()


def _cpu_time():
    """Return the CPU time of this process and its finished children, s."""
    return sum(os.times()[:4])


def _clear_caches():
    """Clear the caches of the core; otherwise, cached functions would count for the first test only."""
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in ("hubodo", "hubowire"):
            for value in list(vars(module).values()):
                if _is_cached(value):
                    value.cache_clear()


def _is_cached(value):
    """Return True for a cached function."""
    return isinstance(value, functools._lru_cache_wrapper)


def pytest_runtest_logstart(nodeid):
    _clear_caches()
    _seconds[nodeid] = -_cpu_time()
    _coverage.switch_context(_file_of(nodeid))


def pytest_runtest_call(item):
    if not any(map(_is_cached, vars(item.module).values())):
        _coverage.switch_context(item.nodeid)


def pytest_runtest_teardown(item):
    _coverage.switch_context(_file_of(item.nodeid))


def pytest_runtest_logfinish(nodeid):
    _seconds[nodeid] += _cpu_time()
    _coverage.switch_context("")


def pytest_runtest_logreport(report):
    if report.failed:
        _failed.add(report.nodeid)


def pytest_sessionfinish():
    _coverage.stop()
    data = _coverage.get_data()
    tests: dict[str, list[str]] = defaultdict(list)
    for nodeid in _seconds:
        if nodeid not in _failed:
            tests[_file_of(nodeid)].append(nodeid)
    executed: dict[str, dict[str, list[tuple[list[int], list[int]]]]] = defaultdict(dict)
    for source_file in sorted(data.measured_files()):
        path = str(Path(source_file).relative_to(ROOT))
        for file, groups in _group_lines(data.contexts_by_lineno(source_file), tests).items():
            executed[file][path] = groups
    with Path(os.environ["MUTANTS_ROWS"]).open("a", encoding="utf-8") as rows:
        for file in sorted({_file_of(nodeid) for nodeid in _seconds}):
            row = {
                "key": file,
                "tests": {nodeid: round(_seconds[nodeid], 3) for nodeid in tests[file]},
                "lines": executed[file],
                "digests": {path: digest(ROOT / path) for path in (file, *executed[file])},
            }
            print(json.dumps(row, separators=(",", ":")), file=rows)


def _group_lines(contexts, tests):
    """Return for each test file groups of test numbers and the lines that exactly these tests execute."""
    positions = {nodeid: (file, k) for file, ids in tests.items() for k, nodeid in enumerate(ids)}
    lines: dict[str, dict[tuple[int, ...], list[int]]] = defaultdict(lambda: defaultdict(list))
    for line, names in contexts.items():
        numbers: dict[str, set[int]] = defaultdict(set)
        for name in names:
            if name in positions:
                file, k = positions[name]
                numbers[file].add(k)
            elif name in tests:
                numbers[name].update(range(len(tests[name])))
        for file, test_numbers in numbers.items():
            lines[file][tuple(sorted(test_numbers))].append(line)
    return {
        file: [(list(test_numbers), line_numbers) for test_numbers, line_numbers in groups.items()]
        for file, groups in lines.items()
    }


def _file_of(nodeid):
    return nodeid.partition("::")[0]
