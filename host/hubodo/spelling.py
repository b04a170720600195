"""Suggestions for misspelt words in errors."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from pathlib import Path

_MAX_COMPARED_LENGTH = 60  # characters; comparison takes quadratic time
_MIN_SIMILARITY = 0.55
_MIN_SIMILARITY_OF_SHORT_WORDS = 0.5
_SHORT_WORD_LENGTH = 3


def suggest_spelling(word: str, known: Iterable[str]) -> str:
    """Return ", did you mean ...?" for an error about an unknown word; "" where no known word is similar."""
    known_by_text = {text.lstrip("-"): text for text in known}  # common hyphens must not count as similarity
    return _suggest(word.lstrip("-"), known_by_text)


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


def _suggest(word: str, known_by_text: Mapping[str, str]) -> str:
    text = word[:_MAX_COMPARED_LENGTH]
    is_short = len(text) <= _SHORT_WORD_LENGTH
    similarity = _MIN_SIMILARITY_OF_SHORT_WORDS if is_short else _MIN_SIMILARITY
    close = difflib.get_close_matches(text, list(known_by_text), 1, similarity)
    return f", did you mean {known_by_text[close[0]]!r}?" if close else ""
