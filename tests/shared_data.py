"""Where the real recordings live: beside the checkout, never inside it."""

import os
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[1]


def where(name: str) -> Path:
    """Folder in which a recording is, where it is anywhere."""
    return Path(os.environ.get("HUBODO_SHARED", _ROOT.parent / "shared")) / "data" / name


def shared_data(name: str) -> Path:
    """Folder of one real recording; skips the test where it is absent, fails it where CI is set."""
    folder = where(name)
    if folder.is_dir():
        return folder
    text = f"recording {name!r} is not at {folder}; set HUBODO_SHARED to the folder that holds data/"
    if os.environ.get("CI"):
        pytest.fail(text)
    pytest.skip(text)
