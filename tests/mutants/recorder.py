"""A pytest plugin: which lines of the core each test executes, and the processor time that it takes.

It adds a row for each test file to the JSON lines `MUTANTS_ROWS`: `tests`, those that passed with their
seconds; `lines`, for each file of the core groups of test numbers and the lines that just these execute;
digests of the files that this hangs on. What fixtures do counts for all tests of the file, as they may share
them, and so does all that is done in a file with cached functions of its own.
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


def _processor_time():
    """Of this process and those that it waited for."""
    return sum(os.times()[:4])


def _forget_computed():
    """Else only the first test of a process would execute what the core computes once."""
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in ("hubodo", "hubowire"):
            for value in list(vars(module).values()):
                if _is_kept(value):
                    value.cache_clear()


def _is_kept(value):
    return isinstance(value, functools._lru_cache_wrapper)


def pytest_runtest_logstart(nodeid):
    _forget_computed()
    _seconds[nodeid] = -_processor_time()
    _coverage.switch_context(_file(nodeid))


def pytest_runtest_call(item):
    if not any(map(_is_kept, vars(item.module).values())):
        _coverage.switch_context(item.nodeid)


def pytest_runtest_teardown(item):
    _coverage.switch_context(_file(item.nodeid))


def pytest_runtest_logfinish(nodeid):
    _seconds[nodeid] += _processor_time()
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
            tests[_file(nodeid)].append(nodeid)
    executed: dict[str, dict[str, list[tuple[list[int], list[int]]]]] = defaultdict(dict)
    for measured in sorted(data.measured_files()):
        path = str(Path(measured).relative_to(ROOT))
        for file, groups in _groups(data.contexts_by_lineno(measured), tests).items():
            executed[file][path] = groups
    with Path(os.environ["MUTANTS_ROWS"]).open("a", encoding="utf-8") as rows:
        for file in sorted({_file(nodeid) for nodeid in _seconds}):
            row = {
                "key": file,
                "tests": {nodeid: round(_seconds[nodeid], 3) for nodeid in tests[file]},
                "lines": executed[file],
                "digests": {path: digest(ROOT / path) for path in (file, *executed[file])},
            }
            print(json.dumps(row, separators=(",", ":")), file=rows)


def _groups(contexts, tests):
    """For each test file: (numbers of its tests, lines that just these execute)."""
    places = {nodeid: (file, k) for file, ids in tests.items() for k, nodeid in enumerate(ids)}
    lines: dict[str, dict[tuple[int, ...], list[int]]] = defaultdict(lambda: defaultdict(list))
    for line, names in contexts.items():
        numbers: dict[str, set[int]] = defaultdict(set)
        for name in names:
            if name in places:
                file, k = places[name]
                numbers[file].add(k)
            elif name in tests:
                numbers[name].update(range(len(tests[name])))
        for file, who in numbers.items():
            lines[file][tuple(sorted(who))].append(line)
    return {file: [(list(who), at) for who, at in groups.items()] for file, groups in lines.items()}


def _file(nodeid):
    return nodeid.partition("::")[0]
