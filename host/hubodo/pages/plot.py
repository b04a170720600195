"""A figure that notebooks display and that can be saved."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from hubodo.atomic_files import StrPath
from hubodo.errors import InputError
from hubodo.pages.drawing import figure_to_svg, parse_drawing_path, save_figure


class Plot:
    """A matplotlib figure; a notebook displays it if it is the value of the last line of a cell.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.

    Attributes
    ----------
    figure : matplotlib.figure.Figure
        The figure, for further changes.
    """

    def __init__(self, figure: Any) -> None:
        self.figure = figure

    def save(self, path: StrPath) -> Path:
        """Write the figure as .png, .svg or .pdf.

        Parameters
        ----------
        path : str or path-like
            The file; its suffix gives the format.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            If the suffix is another one.
        """
        try:
            target = parse_drawing_path(str(path))
        except argparse.ArgumentTypeError as error:
            raise InputError(str(error)) from None
        save_figure(self.figure, target)
        return target

    def _repr_html_(self) -> str:
        return f'<div style="max-width: 50rem; background: #ffffff">{figure_to_svg(self.figure)}</div>'

    def __repr__(self) -> str:
        titles = (axes.get_title() or axes.get_ylabel() for axes in self.figure.axes)
        return f"Plot({', '.join(title for title in titles if title)})"
