"""Summary, tables and page of the Allan deviation of one or several channels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.report.allan_figure import allan_figure
from hubodo.report.drawing import render_drawing
from hubodo.report.page import PageTable, Section, render_page
from hubodo.sensors.allan.characterise import AllanAnalysis
from hubodo.sensors.allan.datasheet import Datasheet
from hubodo.sensors.allan.fit import NoiseTerm
from hubodo.sensors.allan.ieee952 import TermUnit, is_gyro, rate_unit, term_units

NamedAnalysis = tuple[str, AllanAnalysis]
"""Label of a channel, and its analysis."""

_MEANING = {
    "Q": "quantisation of the converter; negligible after a fraction of a second",
    "N": "white noise: the mean over t has a standard deviation of N/√t, the integral one of N·√t",
    "B": "floor of the deviation: averaging does not go below about 0.664 B",
    "K": "random walk of the bias: after a time t it has changed by K·√t (1 sigma)",
    "R": "linear drift of the bias",
}


_SHORT = ("N", "B", "K")
_LEADS = 3


def explain_term(term: str) -> str:
    """Return the practical meaning of a noise term."""
    return _MEANING[term]


def format_value(value: float, unit: str) -> str:
    """Return a value with four digits and its unit."""
    return f"{value:.4g} {unit}"


def format_duration(seconds: float) -> str:
    """Return a duration in s, min, h or days."""
    for size, name in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.3g} s"


def summarise_allan(report: AllanAnalysis) -> str:
    """Return the result in one or two sentences."""
    unit = rate_unit(report.channel)
    if report.best_tau is None or report.best_deviation is None:
        best = "The record is too short to show the best averaging time."
    else:
        best = (
            f"The smallest deviation is {format_value(report.best_deviation * unit.factor, unit.common)} "
            f"({format_value(report.best_deviation, unit.si)}), at an averaging time of "
            f"{format_duration(report.best_tau)}."
        )
    if report.maytag_stop is not None and is_gyro(report.channel):
        best += f" For maytagging, stops of {format_duration(report.maytag_stop)}"
        best += f" (turns of {report.maytag_turn:g} s)."
    return best


def allan_page(reports: Sequence[NamedAnalysis], title: str, sheets: Sequence[Datasheet] = ()) -> str:
    """Return the page of one channel, or of several channels in comparison."""
    if len(reports) == 1:
        _, report = reports[0]
        return render_page(title, summarise_allan(report), allan_sections(report, title, sheets))
    together = Section(
        "Comparison",
        "Points with 95 % intervals and the fitted sum of the terms. Common units, 1σ.",
        [comparison_table(reports, sheets)],
        [render_drawing(lambda: allan_figure(reports, title, sheets))],
    )
    each = [
        Section(f"{name}: {part.title}", part.text, part.tables, part.figures, advice=part.advice)
        for name, report in reports
        for part in allan_sections(report, name, sheets)
    ]
    lead = " ".join(f"{name}: {summarise_allan(report)}" for name, report in reports[:_LEADS])
    return render_page(title, lead, [together, *each])


def comparison_table(reports: Sequence[NamedAnalysis], sheets: Sequence[Datasheet] = ()) -> PageTable:
    """Return a table of channels and data sheets: N, B and K in common units, and the best averaging time."""
    names = term_units(reports[0][1].channel)
    rows = []
    for label, report in reports:
        cells = []
        for name in _SHORT:
            term, factor = report.fit.terms[name], names[name].factor
            if term.value is not None and term.sigma is not None:
                cells.append(f"{term.value * factor:.4g} ± {term.sigma * factor:.2g}")
            else:
                cells.append("not shown" if term.limit is None else f"< {term.limit * factor:.3g}")
        best = "longer" if report.best_tau is None else format_duration(report.best_tau)
        rows.append((label, *cells, best))
    for sheet in sheets:
        terms = sheet.terms(reports[0][1].channel)
        said = [f"{terms[name] * names[name].factor:.4g}" if name in terms else "" for name in _SHORT]
        rows.append((f"{sheet.name}, data sheet", *said, ""))
    heads = [f"{name} {names[name].name}, {names[name].common}" for name in _SHORT]
    return PageTable(("", *heads, "average for"), rows)


def allan_advice(report: AllanAnalysis) -> list[str]:
    """Return recommendations for using the result and for a better record."""
    lines = []
    white, unit = report.fit.terms["N"], term_units(report.channel)["N"]
    if report.best_tau is not None and report.best_deviation is not None:
        lines.append(
            f"Estimate the bias from a standstill of about {format_duration(report.best_tau)}; longer ones do "
            "not improve it."
        )
    if white.value is not None and is_gyro(report.channel):
        lines.append(
            f"White noise alone causes an angle error of {white.value * unit.factor:.4g}° (1σ) in one hour of "
            "integration."
        )
    hidden = [term for term in report.fit.terms.values() if term.value is None]
    waits = [term.needed for term in hidden if term.needed is not None]
    if waits:
        lines.append(f"Record for {format_duration(min(waits))} to detect more terms or lower their limits.")
    if report.fit.factors[0] > 1:
        lines.append(
            "Ignore averaging times shorter than those fitted: they show the low-pass. A wider bandwidth would "
            "show quantisation."
        )
    if report.fit.misfit > 0:
        lines.append(
            "The points ripple about the fit: look for vibration or mains hum near the sensor, and record again."
        )
    if report.record.excluded:
        lines.append("The sensor was disturbed: place it where nothing touches it if the cut times recur.")
    return lines


def terms_table(report: AllanAnalysis) -> PageTable:
    """Return the table of the terms that the record shows."""
    rows = [
        (
            f"{key} {unit.name}",
            f"{term.value:.4g} ± {term.sigma:.2g} {unit.si}",
            format_value(term.value * unit.factor, unit.common),
            explain_term(key),
        )
        for key, unit, term in _terms(report)
        if term.value is not None and term.sigma is not None
    ]
    return PageTable(("term", "SI", "common unit", "meaning"), rows)


def hidden_terms_table(report: AllanAnalysis) -> PageTable:
    """Return the table of the terms that the record does not show, with the reasons."""
    rows = [
        (
            f"{key} {unit.name}",
            "" if term.limit is None else format_value(term.limit, unit.si),
            "" if term.needed is None else format_duration(term.needed),
            term.reason,
        )
        for key, unit, term in _terms(report)
        if term.value is None or term.sigma is None
    ]
    return PageTable(("term", "below (95 %)", "record needed", "why"), rows)


def _terms(report: AllanAnalysis) -> list[tuple[str, TermUnit, NoiseTerm]]:
    return [(key, unit, report.fit.terms[key]) for key, unit in term_units(report.channel).items()]


def allan_sections(
    report: AllanAnalysis, title: str | None = None, sheets: Sequence[Datasheet] = ()
) -> list[Section]:
    """Return the sections of a page: terms, recommendations, figure and record; sheets: also plotted."""
    name = title or report.channel
    shown, missing = terms_table(report), hidden_terms_table(report)
    record = report.record
    account = [
        ("samples", f"{int(np.count_nonzero(record.present))} of {len(record.values)}"),
        ("interval", f"{record.dt:.8g} s"),
        ("duration", format_duration(record.duration)),
        ("gaps", str(len(record.gaps))),
        ("outliers", str(len(record.outliers))),
        ("cut out as disturbed", ", ".join(f"{a:.6g} to {b:.6g} s" for a, b in record.excluded) or "nothing"),
        ("fit", f"chi-square {report.fit.chi2:.4g} for {report.fit.dof} degrees of freedom"),
    ]
    return [
        Section("Noise terms", "Names of IEEE 952; 1σ.", [shown]),
        Section("What to do", advice=allan_advice(report)),
        Section(
            "Allan deviation",
            "Points with 95 % intervals; the line is the sum of the terms, the dashed lines are their "
            "asymptotes. Below: residuals with 1σ; hollow points were not fitted.",
            figures=[render_drawing(lambda: allan_figure([(name, report)], name, sheets))],
        ),
        *([Section("Not observable in this record", "", [missing])] if missing.rows else []),
        Section("The record", " ".join(f"{note}." for note in report.notes), [PageTable(("", ""), account)]),
    ]
