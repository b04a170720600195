"""Requirements of tests that a machine may lack: skip with one line, or fail where nothing may be missing."""

from __future__ import annotations

import importlib
import os
import shutil
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import pytest

SHARED = Path(os.environ.get("HUBODO_SHARED", Path(__file__).resolve().parents[2] / "shared"))


def lacking(text: str) -> NoReturn:
    """Skip the test; fail it if CI is set or the recordings exist, as on a complete machine."""
    if os.environ.get("CI") or SHARED.is_dir():
        pytest.fail(text, pytrace=False)
    pytest.skip(text, allow_module_level=True)


def module(name: str) -> ModuleType:
    """Import an optional package such as `gtsam`, or call `lacking`."""
    try:
        return importlib.import_module(name)
    except ImportError:
        lacking(f"{name.partition('.')[0]} is not installed: run make setup")


def program(*names: str) -> str:
    """Return the path of the first of these programs that is installed."""
    for name in names:
        if path := shutil.which(name):
            return path
    lacking(f"no {names[0]} here: run make browser")


def recording(name: str) -> Path:
    """Return the folder of one real recording, which is stored beside the checkout."""
    folder = SHARED / "data" / name
    if not folder.is_dir():
        lacking(f"recording {name!r} is not at {folder}; set HUBODO_SHARED to the folder that holds data/")
    return folder
