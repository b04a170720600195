"""Summary, tables and figures of a north estimate: result, quality of the fit, recommendations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hubodo.report.drawing import new_figure, render_drawing
from hubodo.report.page import PageTable, Section
from hubodo.sensors.north.north_estimate import NorthEstimate
from hubodo.sensors.north.residuals import NorthResiduals, compute_residuals
from hubodo.sensors.north.result_json import describe_programmes

_DEG, _DEG_H = math.degrees(1.0), math.degrees(1.0) * 3600.0
_INK, _GRID, _OURS, _DIM = "#1d2126", "#d8dce0", "#1b6ca8", "#8a8d91"

Gyros = Sequence[tuple[str, str, NorthEstimate]]


def summarise_north(azimuth: float, sigma: float) -> str:
    """Return the result in one sentence; azimuth, sigma: rad."""
    return f"Table zero points {azimuth * _DEG % 360:.2f}° ± {sigma * _DEG:.2f}° (1σ) clockwise from north."


def north_sections(gyros: Gyros, warnings: Sequence[str]) -> list[Section]:
    """Return the sections of a page: recommendations, then estimates, fit and record of each gyro."""
    advice = describe_programmes(gyros[0][2])
    sections = [Section("What to do", advice=[f"{line}." for line in (*warnings, *advice)])]
    for node, axis, found in gyros:
        name = f"{node} {axis}"
        figures = [render_drawing(lambda found=found, name=name: north_figure(found, name))]  # type: ignore[misc]
        sections.append(Section(f"{name}: estimates", _words(found), [_estimates(found)]))
        sections.append(
            Section(f"{name}: fit", _fit_words(compute_residuals(found)), [_account(found)], figures)
        )
    return sections


def north_figure(found: NorthEstimate, title: str) -> Any:
    """Return a matplotlib figure of Earth rate over angle, residuals over time, and the azimuth's density.

    Raises InputError if matplotlib cannot be loaded.
    """
    made = new_figure(8.0, 8.0)
    upper, middle, lower = made.subplots(3, 1, height_ratios=(3, 2, 2))
    residuals = compute_residuals(found)
    # Angles slightly below zero are plotted on the left, not at 360 degrees.
    angle = (residuals.angle * _DEG + 15) % 360 - 15
    upper.plot(angle, residuals.earth * _DEG_H, ".", ms=3, color=_DIM, label="averages")
    for at, mean, error in _by_direction(residuals, angle):
        upper.errorbar(at, mean * _DEG_H, error * _DEG_H, fmt="o", ms=4, color=_INK)
    turn = np.radians(np.arange(0, 361, 2))
    wave = found.horizontal_rate * np.cos(found.azimuth - turn) * _DEG_H
    upper.plot(turn * _DEG, wave, color=_OURS, label="fit")
    upper.set_xlabel("angle of the axis from table zero, °")
    upper.set_ylabel("Earth rate, °/h")
    upper.legend(fontsize=8)
    upper.set_title(title)
    middle.plot(residuals.t / 60, residuals.residual * _DEG_H, ".-", ms=3, lw=0.6, color=_INK)
    middle.set_xlabel("t, min")
    middle.set_ylabel("residual, °/h")
    density = found.posterior.density / np.gradient(found.posterior.azimuth) / _DEG
    lower.plot(found.posterior.azimuth * _DEG, density, color=_OURS)
    peak = float(found.posterior.azimuth[found.posterior.density.argmax()]) * _DEG
    lower.set_xlim(peak - 6 * found.sigma * _DEG, peak + 6 * found.sigma * _DEG)
    lower.set_xlabel("azimuth of table zero, °")
    lower.set_ylabel("probability density, 1/°")
    for axes in (upper, middle, lower):
        axes.grid(True, lw=0.4, color=_GRID)
    return made


def _by_direction(residuals: NorthResiduals, angle: Any) -> list[tuple[float, float, float]]:
    """Return (degrees, mean, standard error) of the averages per direction, if there are few directions."""
    directions = np.unique(np.round(angle / 3) * 3)
    if len(directions) > 12:
        return []
    made = []
    for at in directions:
        here = residuals.earth[np.round(angle / 3) * 3 == at]
        if len(here) > 1:
            made.append((float(at), float(here.mean()), float(here.std(ddof=1) / math.sqrt(len(here)))))
    return made


def _words(found: NorthEstimate) -> str:
    text = (
        f"Sigma is {found.sigma * _DEG:.2f}°, including the uncertainty of the noise parameters. The Cramér-Rao "
        f"bound for this noise and these stops is {found.bound * _DEG:.2f}°, for white noise only "
        f"{found.white_bound * _DEG:.2f}°."
    )
    if found.angle_sigma:
        text += f" {found.angle_sigma * _DEG:.2f}° of sigma are due to angles measured by the gyro itself."
    return text


def _estimates(found: NorthEstimate) -> PageTable:
    rate, spread = found.rate_components()
    rows = [("maximum likelihood", _rates(rate), _rates(spread), f"{found.azimuth * _DEG % 360:.2f}")]
    for name, one in found.filters.items():
        azimuth = "" if one.azimuth is None else f"{one.azimuth * _DEG % 360:.2f}"
        rows.append((name.replace("_", " "), _rates(one.rate), _rates(one.sigma), azimuth))
    return PageTable(("estimate", "rate, °/h", "sigma, °/h", "azimuth, °"), rows)


def _rates(values: Sequence[float] | Any) -> str:
    return ", ".join(f"{value * _DEG_H:.2f}" for value in values)


def _fit_words(residuals: NorthResiduals) -> str:
    share = float(np.mean(residuals.whitened**2))
    neighbours = float(np.mean(residuals.whitened[1:] * residuals.whitened[:-1])) / share
    limit = 2 / math.sqrt(len(residuals.whitened))
    verdict = (
        "consistent with white noise" if abs(neighbours) < limit else "significant: the model is incomplete"
    )
    return (
        f"Variance of the whitened residuals: {share:.2f} (1 if the model holds). Correlation of neighbours: "
        f"{neighbours:+.2f}, {verdict}."
    )


def _account(found: NorthEstimate) -> PageTable:
    drift = found.posterior.drift
    stops = sum(map(len, found.stops))
    rows = [
        ("method", found.method),
        ("measured", f"{found.duration:.0f} s in {found.elapsed:.0f} s"),
        ("stops", str(stops) if stops else "none, continuous turning"),
        ("N", f"{drift.n * _DEG * 60:.3g} °/√h"),
        ("B", f"{drift.b * _DEG_H:.3g} °/h"),
        ("K", f"{drift.k * _DEG_H * 60:.3g} °/h/√h"),
    ]
    if drift.q:
        rows.append(("Q or vibration", f"{drift.q:.2g} rad"))
    return PageTable(("", ""), rows)
