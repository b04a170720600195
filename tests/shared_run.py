"""Results that test files in different processes share: computed by the first process that needs them."""

from __future__ import annotations

import fcntl
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

Result = TypeVar("Result")


def compute_once(factory: pytest.TempPathFactory, name: str, compute: Callable[[Path], Result]) -> Result:
    """Return the result of `compute` with a new folder of this name; further processes unpickle it."""
    root = factory.getbasetemp()
    folder = (root.parent if "PYTEST_XDIST_WORKER" in os.environ else root) / f"shared-{name}"
    stored = folder.with_suffix(".pickle")
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not stored.exists():
            folder.mkdir(exist_ok=True)
            stored.write_bytes(pickle.dumps(compute(folder)))
    result: Result = pickle.loads(stored.read_bytes())
    return result
