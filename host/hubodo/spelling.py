"""Suggestions for misspelt words in errors."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_MAX_COMPARED_LENGTH = 60  # characters; comparison takes quadratic time


def suggest_spelling(word: str, known: Iterable[str]) -> str:
    """Return ", did you mean ...?" for an error about an unknown word; "" where no known word is similar."""
    close = difflib.get_close_matches(word[:_MAX_COMPARED_LENGTH], list(known), 1, 0.5)
    return f", did you mean {close[0]!r}?" if close else ""
