"""The console on which results are shown: text of logs and users cannot steer the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.text import Text

from hubodo.safe_text import printable


class SafeConsole(Console):
    """A console of rich that escapes control characters in every text it is given."""

    def render_str(self, text: str, **options: Any) -> Text:
        """See `rich.console.Console.render_str`, which every string passes, also in the cells of tables."""
        return super().render_str(printable(text), **options)
