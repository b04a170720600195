"""Table, figure and JSON of the other deviations and the spectral density of a channel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hubodo.arrays import Array
from hubodo.pages.drawing import add_legend_above, new_figure, render_drawing
from hubodo.pages.page import PageTable, Section
from hubodo.sensors.allan.ieee952 import rate_unit
from hubodo.sensors.allan.other_deviations import DEVIATIONS, deviation

if TYPE_CHECKING:
    from hubodo.sensors.allan.result import AllanResult

SPECTRUM = "psd"
OTHER_STATISTICS = (*DEVIATIONS, SPECTRUM)


def other_statistics_json(result: AllanResult) -> dict[str, Any]:
    """Return the requested deviations and spectral density in SI units; {} if none was requested."""
    shown: dict[str, Any] = {}
    if kinds := [kind for kind in result.also if kind != SPECTRUM]:
        shown["other_deviations"] = {kind: _points_json(*deviation(result.record, kind)) for kind in kinds}
    if SPECTRUM in result.also:
        frequency, density = result.spectral_density()
        shown["spectral_density"] = {"frequency_hz": frequency.tolist(), "root_density": density.tolist()}
    return shown


def _points_json(tau: Array, values: Array) -> dict[str, list[float]]:
    return {"tau": tau.tolist(), "deviation": values.tolist()}


def other_statistics_table(result: AllanResult) -> PageTable | None:
    """Return the requested deviations beside that of Allan by averaging time, or None."""
    kinds = [kind for kind in result.also if kind != SPECTRUM]
    if not kinds:
        return None
    unit = rate_unit(result.channel).shown()
    columns = [dict(zip(result.tau, result.adev, strict=True))]
    columns += [dict(zip(*deviation(result.record, kind), strict=True)) for kind in kinds]
    rows = [
        (f"{tau:.4g}", *(_cell(column, tau, unit.factor) for column in columns))
        for tau in sorted(columns[0])
        if any(_nearest(column, tau) is not None for column in columns[1:])
    ]
    return PageTable(("averaging time, s", *(f"{name}, {unit.name}" for name in ("Allan", *kinds))), rows)


def _nearest(column: dict[float, float], tau: float) -> float | None:
    """Return the value at an averaging time, which may differ by rounding."""
    return next((value for at, value in column.items() if abs(at / tau - 1.0) < 1e-9), None)


def _cell(column: dict[float, float], tau: float, factor: float) -> str:
    value = _nearest(column, tau)
    return "" if value is None else f"{value * factor:.4g}"


def other_statistics_sections(result: AllanResult) -> list[Section]:
    """Return the page sections of what was requested."""
    sections = []
    if (table := other_statistics_table(result)) is not None:
        text = "NIST SP 1065; of the longest span without gaps. Hadamard ignores a linear drift."
        sections.append(Section("Other deviations", text, [table]))
    if SPECTRUM in result.also:
        figure = render_drawing(lambda: _spectrum_figure(result))
        sections.append(Section("Spectral density", "One-sided, by Welch's method.", figures=[figure]))
    return sections


def _spectrum_figure(result: AllanResult) -> Any:
    frequency, density = result.spectral_density()
    unit = rate_unit(result.channel).shown()
    plot = new_figure(8.0, 4.0)
    axes = plot.subplots()
    axes.loglog(frequency, density * unit.factor, lw=0.8, color="#1d2126", label="measured")
    white = result.terms["N"].value
    if white is not None:
        level = np.full(2, white * np.sqrt(2.0) * unit.factor)
        axes.loglog(frequency[[0, -1]], level, "--", color="#1b6ca8", label="√2 N, white noise")
    axes.set_xlabel("frequency, Hz")
    axes.set_ylabel(f"root spectral density, {unit.name}/√Hz")
    axes.grid(True, which="major", lw=0.4, color="#d8dce0")
    add_legend_above(plot)
    return plot
