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

_TERM_MEANINGS = {
    "Q": "quantisation of the converter; negligible after a fraction of a second",
    "N": "white noise: the mean over t has a standard deviation of N/√t, the integral one of N·√t",
    "B": "floor of the deviation: averaging does not go below about 0.664 B",
    "K": "random walk of the bias: after a time t it has changed by K·√t (1 sigma)",
    "R": "linear drift of the bias",
}


_COMPARED_TERMS = ("N", "B", "K")
_MAX_LEADS = 3


def explain_term(term: str) -> str:
    """Return the practical meaning of a noise term."""
    return _TERM_MEANINGS[term]


def format_value(value: float, unit: str) -> str:
    """Return a value with four digits and its unit."""
    return f"{value:.4g} {unit}"


def format_duration(seconds: float) -> str:
    """Return a duration in s, min, h or days."""
    for size, name in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.3g} s"


def summarise_allan(analysis: AllanAnalysis) -> str:
    """Return the result in one or two sentences."""
    unit = rate_unit(analysis.channel)
    if analysis.best_tau is None or analysis.best_deviation is None:
        best = "The record is too short to show the best averaging time."
    else:
        best = (
            f"The smallest deviation is {format_value(analysis.best_deviation * unit.factor, unit.common)} "
            f"({format_value(analysis.best_deviation, unit.si)}), at an averaging time of "
            f"{format_duration(analysis.best_tau)}."
        )
    if analysis.maytag_stop is not None and is_gyro(analysis.channel):
        best += f" For maytagging, stops of {format_duration(analysis.maytag_stop)}"
        best += f" (turns of {analysis.maytag_turn:g} s)."
    return best


def allan_page(analyses: Sequence[NamedAnalysis], title: str, sheets: Sequence[Datasheet] = ()) -> str:
    """Return the page of one channel, or of several channels in comparison."""
    if len(analyses) == 1:
        _, analysis = analyses[0]
        return render_page(title, summarise_allan(analysis), allan_sections(analysis, title, sheets))
    together = Section(
        "Comparison",
        "Points with 95 % intervals and the fitted sum of the terms. Common units, 1σ.",
        [comparison_table(analyses, sheets)],
        [render_drawing(lambda: allan_figure(analyses, title, sheets))],
    )
    each = [
        Section(f"{name}: {part.title}", part.text, part.tables, part.figures, advice=part.advice)
        for name, analysis in analyses
        for part in allan_sections(analysis, name, sheets)
    ]
    lead = " ".join(f"{name}: {summarise_allan(analysis)}" for name, analysis in analyses[:_MAX_LEADS])
    return render_page(title, lead, [together, *each])


def comparison_table(analyses: Sequence[NamedAnalysis], sheets: Sequence[Datasheet] = ()) -> PageTable:
    """Return a table of channels and data sheets: N, B and K in common units, and the best averaging time."""
    names = term_units(analyses[0][1].channel)
    rows = []
    for label, analysis in analyses:
        cells = []
        for name in _COMPARED_TERMS:
            term, factor = analysis.fit.terms[name], names[name].factor
            if term.value is not None and term.sigma is not None:
                cells.append(f"{term.value * factor:.4g} ± {term.sigma * factor:.2g}")
            else:
                cells.append("not shown" if term.limit is None else f"< {term.limit * factor:.3g}")
        best = "longer" if analysis.best_tau is None else format_duration(analysis.best_tau)
        rows.append((label, *cells, best))
    for sheet in sheets:
        terms = sheet.terms(analyses[0][1].channel)
        values = [
            f"{terms[name] * names[name].factor:.4g}" if name in terms else "" for name in _COMPARED_TERMS
        ]
        rows.append((f"{sheet.name}, data sheet", *values, ""))
    heads = [f"{name} {names[name].name}, {names[name].common}" for name in _COMPARED_TERMS]
    return PageTable(("", *heads, "average for"), rows)


def allan_advice(analysis: AllanAnalysis) -> list[str]:
    """Return recommendations for using the result and for a better record."""
    lines = []
    white, unit = analysis.fit.terms["N"], term_units(analysis.channel)["N"]
    if analysis.best_tau is not None and analysis.best_deviation is not None:
        lines.append(
            f"Estimate the bias from a standstill of about {format_duration(analysis.best_tau)}; longer ones "
            "do "
            "not improve it."
        )
    if white.value is not None and is_gyro(analysis.channel):
        lines.append(
            f"White noise alone causes an angle error of {white.value * unit.factor:.4g}° (1σ) in one hour "
            "of "
            "integration."
        )
    hidden_terms = [term for term in analysis.fit.terms.values() if term.value is None]
    record_lengths = [term.needed for term in hidden_terms if term.needed is not None]
    if record_lengths:
        lines.append(
            f"Record for {format_duration(min(record_lengths))} to detect more terms or lower their limits."
        )
    if analysis.fit.factors[0] > 1:
        lines.append(
            "Ignore averaging times shorter than those fitted: they show the low-pass. A wider bandwidth "
            "would "
            "show quantisation."
        )
    if analysis.fit.misfit > 0:
        lines.append(
            "The points ripple about the fit: look for vibration or mains hum near the sensor, and record "
            "again."
        )
    if analysis.record.excluded:
        lines.append("The sensor was disturbed: place it where nothing touches it if the cut times recur.")
    return lines


def terms_table(analysis: AllanAnalysis) -> PageTable:
    """Return the table of the terms that the record shows."""
    rows = [
        (
            f"{key} {unit.name}",
            f"{term.value:.4g} ± {term.sigma:.2g} {unit.si}",
            format_value(term.value * unit.factor, unit.common),
            explain_term(key),
        )
        for key, unit, term in _terms(analysis)
        if term.value is not None and term.sigma is not None
    ]
    return PageTable(("term", "SI", "common unit", "meaning"), rows)


def hidden_terms_table(analysis: AllanAnalysis) -> PageTable:
    """Return the table of the terms that the record does not show, with the reasons."""
    rows = [
        (
            f"{key} {unit.name}",
            "" if term.limit is None else format_value(term.limit, unit.si),
            "" if term.needed is None else format_duration(term.needed),
            term.reason,
        )
        for key, unit, term in _terms(analysis)
        if term.value is None or term.sigma is None
    ]
    return PageTable(("term", "below (95 %)", "record needed", "why"), rows)


def _terms(analysis: AllanAnalysis) -> list[tuple[str, TermUnit, NoiseTerm]]:
    return [(key, unit, analysis.fit.terms[key]) for key, unit in term_units(analysis.channel).items()]


def allan_sections(
    analysis: AllanAnalysis, title: str | None = None, sheets: Sequence[Datasheet] = ()
) -> list[Section]:
    """Return the sections of a page: terms, recommendations, figure and record; sheets: also plotted."""
    name = title or analysis.channel
    shown, missing = terms_table(analysis), hidden_terms_table(analysis)
    record = analysis.record
    record_rows = [
        ("samples", f"{int(np.count_nonzero(record.present))} of {len(record.values)}"),
        ("interval", f"{record.dt:.8g} s"),
        ("duration", format_duration(record.duration)),
        ("gaps", str(len(record.gaps))),
        ("outliers", str(len(record.outliers))),
        ("cut out as disturbed", ", ".join(f"{a:.6g} to {b:.6g} s" for a, b in record.excluded) or "nothing"),
        ("fit", f"chi-square {analysis.fit.chi2:.4g} for {analysis.fit.dof} degrees of freedom"),
    ]
    return [
        Section("Noise terms", "Names of IEEE 952; 1σ.", [shown]),
        Section("What to do", advice=allan_advice(analysis)),
        Section(
            "Allan deviation",
            "Points with 95 % intervals; the line is the sum of the terms, the dashed lines are their "
            "asymptotes. Below: residuals with 1σ; hollow points were not fitted.",
            figures=[render_drawing(lambda: allan_figure([(name, analysis)], name, sheets))],
        ),
        *([Section("Not observable in this record", "", [missing])] if missing.rows else []),
        Section(
            "The record", " ".join(f"{note}." for note in analysis.notes), [PageTable(("", ""), record_rows)]
        ),
    ]
