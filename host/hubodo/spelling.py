"""Suggestions for misspelt words in errors."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

_MAX_COMPARED_LENGTH = 60  # characters; comparison takes quadratic time
_MIN_SIMILARITY = 0.55
_MIN_SIMILARITY_OF_SHORT_WORDS = 0.5
_SHORT_WORD_LENGTH = 3
_URL = re.compile(r"([a-z][a-z0-9]+):[/\\]")
"""The beginning of a URL, whose double slash a path does not keep; a drive of Windows has one letter."""
_REMOTE_STORES = ("s3", "gs")


def suggest_spelling(word: str, known: Iterable[str]) -> str:
    """Return ", did you mean ...?" for an error about an unknown word; "" where no known word is similar."""
    known_by_text = {text.lstrip("-"): text for text in known}  # common hyphens must not count as similarity
    return _suggest(word.lstrip("-"), known_by_text)


def suggest_file(path: Path) -> str:
    """Return ", did you mean ...?" for a missing file whose folder holds one of a similar name, else "".

    A path that was a URL is answered by how to read that.
    """
    if match := _URL.match(str(path)):
        remote = "`hubodo batch` reads it" if match[1] in _REMOTE_STORES else "download it first"
        return f"; it is a URL, {remote}"
    try:
        names = sorted(file.name for file in path.parent.iterdir())
    except OSError:
        return ""
    if path.name in names:
        return ""
    # Common suffixes must not count as similarity.
    known_by_stem = {name.partition(".")[0]: str(path.parent / name) for name in reversed(names)}
    return _suggest(path.name.partition(".")[0], known_by_stem)


def _suggest(word: str, known_by_text: Mapping[str, str]) -> str:
    text = word[:_MAX_COMPARED_LENGTH]
    is_short = len(text) <= _SHORT_WORD_LENGTH
    similarity = _MIN_SIMILARITY_OF_SHORT_WORDS if is_short else _MIN_SIMILARITY
    if is_short:  # --web is not --debug
        known_by_text = {it: named for it, named in known_by_text.items() if len(it) <= len(text) + 1}
    close = difflib.get_close_matches(text, list(known_by_text), 1, similarity)
    return f", did you mean {known_by_text[close[0]]!r}?" if close else ""
