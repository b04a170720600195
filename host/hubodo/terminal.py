"""A console for results on which text of logs and users cannot control the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.text import Text

from hubodo.safe_text import printable


class SafeConsole(Console):
    """A rich console that escapes control characters in every text."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Render a string as rich does; every string passes here, also the cells of tables."""
        return super().render_str(printable(text), **options)
