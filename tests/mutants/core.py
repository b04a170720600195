"""Folders of the core that are mutated, and digests of files."""

from __future__ import annotations

import hashlib
from pathlib import Path

CORE = {
    "effects": "host/hubodo/effects",
    "calibration": "host/hubodo/calibration",
    "model": "host/hubodo/model",
    "sensors": "host/hubodo/sensors",
    "fuse": "host/hubodo/fuse",
    "gap": "host/hubodo/gap",
    "node": "host/hubodo/ingest/node",
    "protocol": "protocol/hubowire",
    "firmware": "firmware",
}


def digest(path: Path) -> str:
    """Return a digest of the content of a file, or "" if there is no file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.exists() else ""
