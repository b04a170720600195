"""The corpus: cases that once showed a defect, each as its command and the files that were changed."""

from __future__ import annotations

import hashlib
import json
import zlib
from base64 import b64decode, b64encode
from pathlib import Path

from fuzz.case import Case
from fuzz.settings import SETTINGS
from fuzz.targets import unchanged

CORPUS = Path(__file__).parent / "corpus"


def save_case(target: str, case: Case) -> Path:
    """Store a case, compressed; return its path."""
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


def load_cases() -> list[tuple[str, Case]]:
    """Return all stored cases by name."""
    cases = []
    for path in sorted(CORPUS.glob("*.json")):
        content = json.loads(path.read_text())
        files = {name: zlib.decompress(b64decode(text)) for name, text in content["files"].items()}
        beside = unchanged() if any(name.startswith("log/") for name in files) else SETTINGS
        cases.append((path.stem, Case(tuple(content["words"]), {**beside, **files})))
    return cases
