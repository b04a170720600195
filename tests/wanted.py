"""What a test wants and a machine may lack: it skips with one line, or fails where nothing may be missing."""

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
    """Skip the test; where CI is set, or the recordings are there as on a complete machine, fail it."""
    if os.environ.get("CI") or SHARED.is_dir():
        pytest.fail(text, pytrace=False)
    pytest.skip(text, allow_module_level=True)


def module(name: str) -> ModuleType:
    """A package that is an extra, such as `gtsam`; see `lacking` for where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        lacking(f"{name.partition('.')[0]} is not installed: run make setup")


def program(*names: str) -> str:
    """The first of these programs that is there."""
    for name in names:
        if path := shutil.which(name):
            return path
    lacking(f"no {names[0]} here: run make browser")


def recording(name: str) -> Path:
    """Folder of one real recording, which lies beside the checkout and never inside it."""
    folder = SHARED / "data" / name
    if not folder.is_dir():
        lacking(f"recording {name!r} is not at {folder}; set HUBODO_SHARED to the folder that holds data/")
    return folder
