"""A pytest plugin that runs the tests of `MUTANTS_CHOSEN` in order and writes `MUTANTS_FAILED`.

The process is killed by SIGPROF after `MUTANTS_SECONDS` of CPU time. Child processes have no limit: a killed
emulated board would look like a failed test.
"""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest

_test_ids = json.loads(Path(os.environ["MUTANTS_CHOSEN"]).read_text("utf-8"))
_position_by_test = {nodeid: position for position, nodeid in enumerate(_test_ids)}
_failed: list[str] = []
signal.setitimer(signal.ITIMER_PROF, float(os.environ["MUTANTS_SECONDS"]))


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    if _position_by_test:
        items[:] = sorted(
            (item for item in items if item.nodeid in _position_by_test),
            key=lambda item: _position_by_test[item.nodeid],
        )


def pytest_runtest_logreport(report):
    if report.failed:
        _failed.append(report.nodeid)


def pytest_sessionfinish():
    Path(os.environ["MUTANTS_FAILED"]).write_text(json.dumps(_failed), "utf-8")
