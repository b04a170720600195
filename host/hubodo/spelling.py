"""Suggestions for misspelt words in errors."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path

_MAX_COMPARED_LENGTH = 60  # characters; comparison takes quadratic time
_MIN_SIMILARITY = 0.55
_MIN_SIMILARITY_OF_SHORT_WORDS = 0.5
_SHORT_WORD_LENGTH = 3


def suggest_spelling(word: str, known: Iterable[str]) -> str:
    """Return ", did you mean ...?" for an error about an unknown word; "" where no known word is similar."""
    known_by_text = {text.lstrip("-"): text for text in known}  # common hyphens must not count as similarity
    text = word[:_MAX_COMPARED_LENGTH].lstrip("-")
    is_short = len(text) <= _SHORT_WORD_LENGTH
    similarity = _MIN_SIMILARITY_OF_SHORT_WORDS if is_short else _MIN_SIMILARITY
    close = difflib.get_close_matches(text, list(known_by_text), 1, similarity)
    return f", did you mean {known_by_text[close[0]]!r}?" if close else ""


def suggest_file(path: Path) -> str:
    """Return ", did you mean ...?" for a missing file whose folder holds one of a similar name, else ""."""
    try:
        names = sorted(file.name for file in path.parent.iterdir())
    except OSError:
        return ""
    if path.name in names:
        return ""
    stem = path.name.partition(".")[0]
    same_stem = next((name for name in names if name.partition(".")[0] == stem), None)
    if same_stem is not None:
        return f", did you mean {str(path.parent / same_stem)!r}?"
    return suggest_spelling(path.name, names)
