"""A figure that a notebook shows by itself and that can be saved."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from hubodo.api.given import StrPath
from hubodo.errors import InputError
from hubodo.report.drawing import drawing_path, save, svg


class Plot:
    """A figure of matplotlib; a notebook shows it where it stands on the last line of a cell.

    Attributes:
        figure: the `matplotlib.figure.Figure` itself, for whoever wants to change it.
    """

    def __init__(self, figure: Any) -> None:
        self.figure = figure

    def save(self, path: StrPath) -> Path:
        """Write it as .png, .svg or .pdf. Raises InputError for another suffix."""
        try:
            target = drawing_path(str(path))
        except argparse.ArgumentTypeError as error:
            raise InputError(str(error)) from None
        save(self.figure, target)
        return target

    def _repr_html_(self) -> str:
        return f'<div style="max-width: 50rem; background: #ffffff">{svg(self.figure)}</div>'

    def __repr__(self) -> str:
        titles = (axes.get_title() or axes.get_ylabel() for axes in self.figure.axes)
        return f"Plot({', '.join(title for title in titles if title)})"
