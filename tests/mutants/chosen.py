"""A pytest plugin: runs the tests listed in `MUTANTS_CHOSEN`, in that order; writes `MUTANTS_FAILED`.

After `MUTANTS_SECONDS` of processor time it is killed by SIGPROF. What it starts has no limit of its own: a
board that is killed would look like a test that fails.
"""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest

_listed = json.loads(Path(os.environ["MUTANTS_CHOSEN"]).read_text("utf-8"))
_chosen = {nodeid: place for place, nodeid in enumerate(_listed)}
_failed: list[str] = []
signal.setitimer(signal.ITIMER_PROF, float(os.environ["MUTANTS_SECONDS"]))


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    if _chosen:
        items[:] = sorted((item for item in items if item.nodeid in _chosen), key=lambda i: _chosen[i.nodeid])


def pytest_runtest_logreport(report):
    if report.failed:
        _failed.append(report.nodeid)


def pytest_sessionfinish():
    Path(os.environ["MUTANTS_FAILED"]).write_text(json.dumps(_failed), "utf-8")
