"""Summary, tables and page of the Allan deviation of one or several channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hubodo.calibration.parameter_table import format_with_sigma
from hubodo.pages.drawing import render_drawing
from hubodo.pages.page import PageTable, Section, render_page
from hubodo.sensors.allan.datasheet import Datasheet
from hubodo.sensors.allan.figure import allan_figure
from hubodo.sensors.allan.fit import NoiseTerm
from hubodo.sensors.allan.ieee952 import TermUnit, is_gyro, rate_unit, term_units
from hubodo.sensors.allan.other_statistics import other_statistics_sections
from hubodo.sensors.allan.repeatability import find_bias_repeatability
from hubodo.unit_systems import angle_text, unit_system

if TYPE_CHECKING:
    from hubodo.sensors.allan.result import AllanResult

NamedResult = tuple[str, "AllanResult"]
"""Label of a channel, and its result."""

TERM_MEANINGS = {
    "Q": "quantisation of the converter; negligible after a fraction of a second",
    "N": "white noise: the mean over t has a standard deviation of N/√t, the integral one of N·√t",
    "B": "floor of the deviation: averaging does not go below about 0.664 B",
    "K": "random walk of the bias: after a time t it has changed by K·√t (1 sigma)",
    "R": "linear drift of the bias",
}
_COMPARED_TERMS = ("N", "B", "K")
_MAX_LEADS = 3


def format_value(value: float, unit: str) -> str:
    """Return a value with four digits and its unit."""
    return f"{value:.4g} {unit}"


def format_duration(seconds: float) -> str:
    """Return a duration in s, min, h or days."""
    for size, name in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.3g} s"


def summarise_allan(result: AllanResult) -> str:
    """Return the result in one or two sentences."""
    unit, white = rate_unit(result.channel), _white_noise_text(result)
    if result.best_tau is None or result.best_deviation is None:
        best = f"{white}The record is too short to show the best averaging time."
    else:
        best = (
            f"{white}The smallest deviation is {_format_in_both(result.best_deviation, unit)}, "
            f"at an averaging time of {format_duration(result.best_tau)}."
        )
    if result.maytag_stop is not None and is_gyro(result.channel):
        best += f" For maytagging, stops of {format_duration(result.maytag_stop)}"
        best += f" (turns of {result.maytag_turn:g} s)."
    return best


def _white_noise_text(result: AllanResult) -> str:
    """Return the white noise as a sentence; "" if the record does not show it."""
    white, unit = result.fit.terms["N"], term_units(result.channel)["N"]
    if white.value is None or white.sigma is None:
        return ""
    return f"White noise N = {_format_in_both(white.value, unit, white.sigma)}. "


def _format_in_both(value: float, unit: TermUnit, sigma: float = 0.0) -> str:
    """Return a value in the common unit, with its sigma, and in SI; or in the chosen one of them."""
    shown = unit.shown()
    text = format_value(value * shown.factor, shown.name)
    if sigma:
        text = f"{_format_with_sigma(value * shown.factor, sigma * shown.factor)} {shown.name}"
    return text if unit_system() else f"{text} ({format_value(value, unit.si)})"


def _format_with_sigma(value: float, sigma: float) -> str:
    """Return value and sigma of a positive quantity as text."""
    return format_with_sigma(value, sigma).replace("+", "", 1)


def allan_page(results: Sequence[NamedResult], title: str, sheets: Sequence[Datasheet] = ()) -> str:
    """Return the page of one channel, or of several channels in comparison."""
    if len(results) == 1:
        _, result = results[0]
        return render_page(title, summarise_allan(result), allan_sections(result, title, sheets))
    together = Section(
        "Comparison",
        " ".join(
            [
                "Points with 95 % intervals and the fitted sum of the terms; 1σ.",
                *(f"{it.describe()}." for it in find_bias_repeatability([result for _, result in results])),
            ]
        ),
        [comparison_table(results, sheets)],
        [render_drawing(lambda: allan_figure(results, title, sheets))],
    )
    each = [
        replace(part, title=f"{name}: {part.title}", is_folded=True)
        for name, result in results
        for part in allan_sections(result, name, sheets)
    ]
    lead = " ".join(f"{name}: {summarise_allan(result)}" for name, result in results[:_MAX_LEADS])
    return render_page(title, lead, [together, *each])


def comparison_table(results: Sequence[NamedResult], sheets: Sequence[Datasheet] = ()) -> PageTable:
    """Return a table of channels and data sheets: N, B and K, and the best averaging time."""
    names = term_units(results[0][1].channel)
    rows = []
    for label, result in results:
        cells = []
        for name in _COMPARED_TERMS:
            term, factor = result.fit.terms[name], names[name].shown().factor
            if term.value is not None and term.sigma is not None:
                cells.append(f"{term.value * factor:.4g} ± {term.sigma * factor:.2g}")
            else:
                cells.append("not shown" if term.limit is None else f"< {term.limit * factor:.3g}")
        best = "longer" if result.best_tau is None else format_duration(result.best_tau)
        rows.append((label, *cells, best))
    for sheet in sheets:
        terms = sheet.terms(results[0][1].channel)
        values = [
            f"{terms[name] * names[name].shown().factor:.4g}" if name in terms else ""
            for name in _COMPARED_TERMS
        ]
        rows.append((f"{sheet.name}, data sheet", *values, ""))
    heads = [f"{name} {names[name].name}, {names[name].shown().name}" for name in _COMPARED_TERMS]
    return PageTable(("", *heads, "average for"), rows)


def allan_advice(result: AllanResult) -> list[str]:
    """Return recommendations for using the result and for a better record."""
    lines = []
    white = result.fit.terms["N"]
    if result.best_tau is not None and result.best_deviation is not None:
        lines.append(
            f"Estimate the bias from a standstill of about {format_duration(result.best_tau)}; "
            "longer ones do not improve it."
        )
    if white.value is not None and is_gyro(result.channel):
        angle = angle_text(white.value * 60.0, ".4g")  # √3600 s = 60 √s
        lines.append(f"White noise alone causes an angle error of {angle} (1σ) in one hour of integration.")
    hidden_terms = [term for term in result.fit.terms.values() if term.value is None]
    record_lengths = [term.needed for term in hidden_terms if term.needed is not None]
    if record_lengths:
        lines.append(
            f"Record for {format_duration(min(record_lengths))} to detect more terms or lower their limits."
        )
    if result.fit.factors[0] > 1:
        lines.append(
            "Ignore averaging times shorter than those fitted: they show the low-pass. "
            "A wider bandwidth would show quantisation."
        )
    if result.fit.misfit > 0:
        lines.append(
            "The points ripple about the fit: look for vibration or mains hum near the sensor, "
            "and record again."
        )
    if result.record.excluded:
        lines.append("The sensor was disturbed: place it where nothing touches it if the cut times recur.")
    return lines


def terms_table(result: AllanResult) -> PageTable:
    """Return the table of the terms that the record shows."""
    rows = [
        (
            f"{key} {unit.name}",
            f"{_format_with_sigma(term.value * shown.factor, term.sigma * shown.factor)} {shown.name}",
            format_value(term.value, unit.si),
            TERM_MEANINGS[key],
        )
        for key, unit, term in _terms(result)
        for shown in (unit.shown(),)
        if term.value is not None and term.sigma is not None
    ]
    headings = ("term", "value ± 1σ", "in SI units", "meaning")
    if unit_system():  # the value has the chosen unit
        return PageTable((*headings[:2], headings[3]), [(*row[:2], row[3]) for row in rows])
    return PageTable(headings, rows)


def all_term_rows(result: AllanResult) -> list[tuple[str, ...]]:
    """Return a row of headings, then key, name, values with sigma and meaning of every term."""
    rows: list[tuple[str, ...]] = [("", "term", "value", "± 1σ", "common unit", "meaning")]
    for key, unit, term in _terms(result):
        if term.value is None or term.sigma is None:
            limit = "" if term.limit is None else f"below {_format_limit(term.limit, unit)} (95 %); "
            needed = (
                "" if term.needed is None else f"; a record of {format_duration(term.needed)} would show it"
            )
            rows.append((key, unit.name, "not observable", "", "", f"{limit}{term.reason}{needed}"))
        else:
            share = f"{100 * term.sigma / term.value:.2g} %"
            values = format_value(term.value, unit.si), share
            common = format_value(term.value * unit.factor, unit.common)
            rows.append((key, unit.name, *values, common, TERM_MEANINGS[key]))
    if unit_system() == "common":
        return [
            (*row[:2], row[4] or row[2], row[3], row[5])
            for row in (("", "term", "", "± 1σ", "value", "meaning"), *rows[1:])
        ]
    return [row[:4] + row[5:] for row in rows] if unit_system() else rows


def _format_limit(limit: float, unit: TermUnit) -> str:
    """Return the limit of a term that the record does not show."""
    shown = unit.shown(si_by_default=True)
    return format_value(limit * shown.factor, shown.name)


def hidden_terms_table(result: AllanResult) -> PageTable:
    """Return the table of the terms that the record does not show, with the reasons."""
    rows = [
        (
            f"{key} {unit.name}",
            "" if term.limit is None else f"{term.limit * shown.factor:.2g} {shown.name}",
            "" if term.needed is None else format_duration(term.needed),
            term.reason,
        )
        for key, unit, term in _terms(result)
        for shown in (unit.shown(si_by_default=True),)
        if term.value is None or term.sigma is None
    ]
    return PageTable(("term", "below (95 %)", "record needed", "why"), rows)


def _terms(result: AllanResult) -> list[tuple[str, TermUnit, NoiseTerm]]:
    return [(key, unit, result.fit.terms[key]) for key, unit in term_units(result.channel).items()]


def allan_sections(
    result: AllanResult, title: str | None = None, sheets: Sequence[Datasheet] = ()
) -> list[Section]:
    """Return the sections of a page: terms, recommendations, figure and record.

    sheets: data sheets that are plotted too.
    """
    name = title or result.channel
    shown, missing = terms_table(result), hidden_terms_table(result)
    record = result.record
    record_rows = [
        ("samples", f"{int(np.count_nonzero(record.present))} of {len(record.values)}"),
        ("interval", f"{record.dt:.8g} s"),
        ("duration", format_duration(record.duration)),
        ("gaps", str(len(record.gaps))),
        ("outliers", str(len(record.outliers))),
        ("cut out as disturbed", ", ".join(f"{a:.6g} to {b:.6g} s" for a, b in record.excluded) or "nothing"),
        ("fit", f"chi-square {result.fit.chi2:.4g} for {result.fit.dof} degrees of freedom"),
    ]
    return [
        Section("Noise terms", "Names of IEEE 952; 1σ.", [shown]),
        Section("What to do", advice=allan_advice(result)),
        Section(
            "Allan deviation",
            "The band and the bars are 95 % intervals; the line is the sum of the terms, the dashed lines "
            "are their asymptotes, and N, B and K stand where their value is read. Below: residuals with "
            "1σ; hollow points were not fitted.",
            figures=[render_drawing(lambda: allan_figure([(name, result)], name, sheets))],
        ),
        *other_statistics_sections(result),
        *([Section("Not observable in this record", "", [missing])] if missing.rows else []),
        Section(
            "The record",
            " ".join(f"{note}." for note in result.notes),
            [PageTable(("", ""), record_rows)],
            is_folded=True,
        ),
    ]
