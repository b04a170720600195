"""Type of the callback with which long operations report their progress."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called with the activity, and the completed share from 0 to 1."""
