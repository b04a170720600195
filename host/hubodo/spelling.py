"""Suggestions for misspelt words in errors."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

_MAX_COMPARED_LENGTH = 60  # characters; comparison takes quadratic time
_MIN_SIMILARITY = 0.55
_MIN_SIMILARITY_OF_OPTIONS = 0.65
_MIN_SIMILARITY_OF_SHORT_WORDS = 0.5
_SHORT_WORD_LENGTH = 3
_URL = re.compile(r"([a-z][a-z0-9]+):[/\\]")
"""The beginning of a URL, whose double slash a path does not keep; a drive of Windows has one letter."""
_SLASHES = {"ros2": ":/", "file": ":///"}
_MEANT_BY_SCHEME = (
    {"file": "a URL; give its path"}
    | dict.fromkeys(("s3", "gs"), "a URL; `hubodo batch` reads it")
    | dict.fromkeys(("udp", "ble", "socket", "ros2", "tcp"), "a port; `hubodo record` makes a log of it")
)


def suggest_spelling(word: str, known: Iterable[str]) -> str:
    """Return ", did you mean ...?" for an error about an unknown word; "" where no known word is similar."""
    known_by_text = {text.lstrip("-"): text for text in known}  # common hyphens must not count as similarity
    minimum = _MIN_SIMILARITY_OF_OPTIONS if word.startswith("--") else _MIN_SIMILARITY
    return _suggest(word.lstrip("-"), known_by_text, minimum)


def explain_missing_file(path: Path, reason: str) -> str:
    """Return the error for an unreadable file, with what was meant: a URL, a port or a similar name."""
    if match := _URL.match(str(path)):
        url = match[1] + _SLASHES.get(match[1], "://") + str(path)[match.end() :]
        return f"{url}: is {_MEANT_BY_SCHEME.get(match[1], 'a URL; download the file and name it')}"
    return f"{path}: {reason}{suggest_file(path)}"


def suggest_file(path: Path) -> str:
    """Return ", did you mean ...?" for a missing file whose folder holds one of a similar name, else ""."""
    try:
        names = sorted(file.name for file in path.parent.iterdir())
    except OSError:
        return ""
    if path.name in names:
        return ""
    # Common suffixes must not count as similarity.
    known_by_stem = {name.partition(".")[0]: str(path.parent / name) for name in reversed(names)}
    return _suggest(path.name.partition(".")[0], known_by_stem)


def _suggest(word: str, known_by_text: Mapping[str, str], minimum: float = _MIN_SIMILARITY) -> str:
    text = word[:_MAX_COMPARED_LENGTH]
    is_short = len(text) <= _SHORT_WORD_LENGTH
    similarity = _MIN_SIMILARITY_OF_SHORT_WORDS if is_short else minimum
    if is_short:  # --web is not --debug
        known_by_text = {it: named for it, named in known_by_text.items() if len(it) <= len(text) + 1}
    close = difflib.get_close_matches(text, list(known_by_text), 1, similarity)
    return f", did you mean {known_by_text[close[0]]!r}?" if close else ""
