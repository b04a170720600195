"""An empty figure for a PNG file; matplotlib is an extra that not everybody has."""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path
from typing import Any


def png_path(text: str) -> Path:
    """Value of an option that writes a PNG; refused before any work where nothing could draw it."""
    if find_spec("matplotlib") is None:
        raise argparse.ArgumentTypeError(
            "needs matplotlib, which is missing: pip install 'hubodo[figures]', or use --report"
        )
    return Path(text)


def blank(width_inches: float, height_inches: float) -> Any:
    """A matplotlib figure that needs no screen."""
    # Imported here: half a second that only those who want a picture pay.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_inches, height_inches), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
