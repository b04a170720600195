"""The corpus: cases that once broke something, each the files that were changed and its command."""

from __future__ import annotations

import hashlib
import json
import zlib
from base64 import b64decode, b64encode
from pathlib import Path

from fuzz.targets import SETTINGS, Case, unchanged

CORPUS = Path(__file__).parent / "corpus"


def keep(target: str, case: Case) -> Path:
    """Writes a case down, packed; returns its path."""
    files = {
        name: b64encode(zlib.compress(content, 9)).decode()
        for name, content in case.files.items()
        if content != unchanged().get(name)
    }
    text = json.dumps({"words": case.words, "files": files}, indent=1) + "\n"
    path = CORPUS / f"{target}-{hashlib.sha256(text.encode()).hexdigest()[:12]}.json"
    CORPUS.mkdir(exist_ok=True)
    path.write_text(text)
    return path


def kept() -> list[tuple[str, Case]]:
    """All of them by name."""
    found = []
    for path in sorted(CORPUS.glob("*.json")):
        told = json.loads(path.read_text())
        files = {name: zlib.decompress(b64decode(text)) for name, text in told["files"].items()}
        beside = unchanged() if any(name.startswith("log/") for name in files) else SETTINGS
        found.append((path.stem, Case(tuple(told["words"]), {**beside, **files})))
    return found
