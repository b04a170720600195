"""A console for results, on which text from logs and users cannot control the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.text import Text

from hubodo.safe_text import printable


class SafeConsole(Console):
    """A rich console that escapes control characters in every text."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Render a string as rich does, but escaped; rich calls this for every string and table cell."""
        return super().render_str(printable(text), **options)
