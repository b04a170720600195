"""Summary, tables and figures of a north estimate: result, quality of the fit, recommendations."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from hubodo.pages.drawing import add_legend_above, new_figure, render_drawing
from hubodo.pages.page import PageTable, Section
from hubodo.sensors.north.advice import describe_programmes
from hubodo.sensors.north.circular import wrap_angle
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.estimates_figure import describe_estimates, estimates_figure
from hubodo.sensors.north.north_estimate import NorthEstimate
from hubodo.sensors.north.residuals import NorthResiduals, compute_residuals
from hubodo.unit_systems import ANGLE, ANGLE_RANDOM_WALK, RATE, RATE_RANDOM_WALK, angle_text

if TYPE_CHECKING:
    from hubodo.sensors.north.result import NorthResult

_DEG = math.degrees(1.0)
_MEAN_COLOUR, _GRID_COLOUR, _FIT_COLOUR, _POINT_COLOUR = "#1d2126", "#d8dce0", "#1b6ca8", "#8a8d91"


def summarise_north(result: NorthResult) -> str:
    """Return the result in one sentence."""
    azimuth = result.describe_azimuth(count_decimals(result.sigma))
    return f"Table zero points {azimuth} (1σ) clockwise from north."


def count_decimals(sigma: float) -> int:
    """Return the decimals of degrees that show two digits of a sigma in rad, 3 at most."""
    if not 0.0 < sigma < math.inf:
        return 0
    return min(max(1 - math.floor(math.log10(sigma * _DEG)), 0), 3)


def north_sections(result: NorthResult) -> list[Section]:
    """Return the sections of a page: recommendations, then estimates, fit and record of each gyro."""
    advice = describe_programmes(result.gyros[0])
    sections = [Section("What to do", advice=[f"{line}." for line in (*result.warnings, *advice)])]
    for estimate in result.gyros:
        name = estimate.name
        figures = [render_drawing(lambda estimate=estimate, name=name: north_figure(estimate, name))]  # type: ignore[misc]
        table = PageTable(("estimate", *rate_headings()), estimate_rows(estimate, 2))
        fit = _fit_text(compute_residuals(estimate))
        sections += [
            Section(f"{name}: estimates", _bound_text(estimate), [table]),
            Section(f"{name}: fit", fit, [_record_table(estimate)], figures),
            Section(
                f"{name}: single estimates",
                describe_estimates(estimate),
                figures=[render_drawing(lambda estimate=estimate: estimates_figure(estimate))],  # type: ignore[misc]
            ),
        ]
    return sections


def north_figure(estimate: NorthEstimate, title: str) -> Any:
    """Return a matplotlib figure of Earth rate over angle, residuals over time, and the azimuth's density.

    Raises InputError if matplotlib cannot be loaded.
    """
    plot = new_figure(8.0, 8.0)
    upper, middle, lower = plot.subplots(3, 1, height_ratios=(3, 2, 2))
    residuals, rate = compute_residuals(estimate), RATE.shown()
    # Angles slightly below zero are plotted on the left, not at 360 degrees.
    angle = (residuals.angle * _DEG + 15) % 360 - 15
    upper.plot(angle, residuals.earth * rate.factor, ".", ms=3, color=_POINT_COLOUR, label="averages")
    for direction, mean, error in _by_direction(residuals, angle):
        upper.errorbar(direction, mean * rate.factor, error * rate.factor, fmt="o", ms=4, color=_MEAN_COLOUR)
    turn = np.radians(np.arange(0, 361, 2))
    model = estimate.horizontal_rate * np.cos(estimate.azimuth - turn) * rate.factor
    upper.plot(turn * _DEG, model, color=_FIT_COLOUR, label="fit")
    upper.set_xlabel("angle of the axis from table zero, °")
    upper.set_ylabel(f"Earth rate, {rate.name}")
    add_legend_above(plot)
    upper.set_title(title)
    middle.plot(residuals.t / 60, residuals.residual * rate.factor, ".-", ms=3, lw=0.6, color=_MEAN_COLOUR)
    middle.set_xlabel("t, min")
    middle.set_ylabel(f"residual, {rate.name}")
    density = estimate.posterior.density / np.gradient(estimate.posterior.azimuth) / _DEG
    centre = estimate.azimuth
    half_width = min(6.0 * estimate.sigma, math.pi)
    if estimate.other_azimuth is not None:
        # The whole circle, with the middle between both maxima at the centre.
        centre = (
            estimate.azimuth + float(wrap_angle(estimate.other_azimuth - estimate.azimuth)) / 2.0
        ) % math.tau
        half_width = math.pi
    offset = wrap_angle(estimate.posterior.azimuth - centre)
    order = np.argsort(offset)
    lower.plot((centre + offset[order]) * _DEG, density[order], color=_FIT_COLOUR)
    lower.set_xlim((centre - half_width) * _DEG, (centre + half_width) * _DEG)
    if half_width == math.pi:
        lower.xaxis.set_major_formatter(lambda degrees, _: f"{degrees % 360.0:.0f}")
    lower.set_xlabel("azimuth of table zero, °")
    lower.set_ylabel("probability density, 1/°")
    for axes in (upper, middle, lower):
        axes.grid(True, lw=0.4, color=_GRID_COLOUR)
    return plot


def _by_direction(residuals: NorthResiduals, angle: Any) -> list[tuple[float, float, float]]:
    """Return (degrees, mean, standard error) of the averages per direction, if there are few directions."""
    directions = np.unique(np.round(angle / 3) * 3)
    if len(directions) > 12:
        return []
    plot = []
    for direction in directions:
        in_direction = residuals.earth[np.round(angle / 3) * 3 == direction]
        if len(in_direction) > 1:
            plot.append(
                (
                    float(direction),
                    float(in_direction.mean()),
                    float(in_direction.std(ddof=1) / math.sqrt(len(in_direction))),
                )
            )
    return plot


def describe_white_bound(estimate: NorthEstimate) -> str:
    """Return a phrase with the azimuth sigma that white noise alone would give."""
    if not math.isfinite(estimate.white_bound):
        return "with stops along a line to north or south there is no Cramér-Rao bound"
    decimals = count_decimals(estimate.white_bound)
    return f"white noise alone would give {angle_text(estimate.white_bound, f'.{decimals}f')}"


def explain_sigma_below_bound(estimate: NorthEstimate) -> str:
    """Return the reason why sigma is below the Cramér-Rao bound, or "" if it is not."""
    if not estimate.sigma < estimate.bound < math.inf:
        return ""
    ratio = estimate.earth_rate.measured / estimate.earth_rate.demanded
    cause = "the bound holds for the most probable noise only, sigma for all that the record allows"
    if ratio > 1.0 and not estimate.earth_rate.depends_on_latitude:
        cause = (
            f"noise made the measured Earth rate {ratio:.2f} times the true one in this record, which "
            "determines its direction better"
        )
    elif estimate.earth_rate.depends_on_latitude:
        cause = "the probability near north and south is not Gaussian: the size of Earth rate limits it"
    return (
        f"sigma is that of this record, {angle_text(estimate.sigma, '.2f')}, the bound of "
        f"{angle_text(estimate.bound, '.2f')} that of the average record: {cause}"
    )


def _bound_text(estimate: NorthEstimate) -> str:
    decimals = f".{count_decimals(estimate.sigma)}f"
    text = (
        f"Sigma is {angle_text(estimate.sigma, decimals)}, including the doubt about the noise parameters. "
    )
    if math.isfinite(estimate.bound):
        text += (
            f"The Cramér-Rao bound for this noise and these stops is {angle_text(estimate.bound, decimals)}; "
        )
    text += f"{describe_white_bound(estimate)}."
    if explanation := explain_sigma_below_bound(estimate):
        text += f" {explanation[0].upper()}{explanation[1:]}."
    if estimate.angle_sigma:
        angle = angle_text(estimate.angle_sigma, ".2f")
        text += f" {angle} of sigma are due to angles measured by the gyro itself."
    return text


def estimate_rows(estimate: NorthEstimate, digits: int) -> list[tuple[str, str, str, str]]:
    """Return name, rates with sigmas and azimuth of each estimator; digits: decimals of the rates."""

    def row(name: str, rates: Iterable[float], sigmas: Iterable[float], azimuth: float | None) -> Any:
        cells = (", ".join(rate.number(v, f".{digits}f") for v in values) for values in (rates, sigmas))
        return name, *cells, "" if azimuth is None else angle.number(azimuth % math.tau, ".2f")

    rate, angle = RATE.shown(), ANGLE.shown()

    return [
        row("maximum likelihood", *estimate.rate_components(), estimate.azimuth),
        *(row(name.replace("_", " "), f.rate, f.sigma, f.azimuth) for name, f in estimate.filters.items()),
    ]


def rate_headings() -> tuple[str, str, str]:
    """Return the headings of `estimate_rows` after the name."""
    rate, angle = RATE.shown().name, ANGLE.shown().name
    return f"rate, {rate}", f"sigma, {rate}", f"azimuth, {angle}"


def noise_rows(drift: DriftNoise) -> list[tuple[str, str]]:
    """Return name and value of N, B and K."""
    terms = (("N", drift.n, ANGLE_RANDOM_WALK), ("B", drift.b, RATE), ("K", drift.k, RATE_RANDOM_WALK))
    return [(name, f"{value * unit.shown().factor:.3g} {unit.shown().name}") for name, value, unit in terms]


def _fit_text(residuals: NorthResiduals) -> str:
    variance = float(np.mean(residuals.whitened**2))
    neighbours = float(np.mean(residuals.whitened[1:] * residuals.whitened[:-1])) / variance
    limit = 2 / math.sqrt(len(residuals.whitened))
    verdict = (
        "consistent with white noise" if abs(neighbours) < limit else "significant: the model is incomplete"
    )
    return (
        f"Variance of the whitened residuals: {variance:.2f} (1 if the model holds). "
        f"Correlation of neighbours: {neighbours:+.2f}, {verdict}."
    )


def _describe_bias(estimate: NorthEstimate) -> str:
    parts = ["constant", "ramp"] + (["bend"] if estimate.posterior.order > 1 else [])
    return ", ".join([*parts, "follows the temperature"] if estimate.posterior.uses_temperature else parts)


def _record_table(estimate: NorthEstimate) -> PageTable:
    drift = estimate.posterior.drift
    stops = sum(map(len, estimate.stops))
    rows = [
        ("method", estimate.method),
        ("measured", f"{estimate.duration:.0f} s in {estimate.elapsed:.0f} s"),
        ("stops", str(stops) if stops else "none, continuous turning"),
        ("bias", _describe_bias(estimate)),
        *noise_rows(drift),
    ]
    if drift.q:
        rows.append(("Q or vibration", f"{drift.q:.2g} rad"))
    return PageTable(("", ""), rows)
