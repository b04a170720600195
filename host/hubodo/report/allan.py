"""The Allan deviation of one channel or several as words, tables and a page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.report.allan_figure import allan_figure
from hubodo.report.drawing import drawing
from hubodo.report.page import Grid, Section, page
from hubodo.sensors.allan.characterise import AllanReport
from hubodo.sensors.allan.datasheet import Datasheet
from hubodo.sensors.allan.fit import NoiseTerm
from hubodo.sensors.allan.ieee952 import TermUnit, is_gyro, rate_unit, term_units

Named = tuple[str, AllanReport]
"""A result and the name of the channel it is of."""

_MEANING = {
    "Q": "steps of the converter; gone after a fraction of a second",
    "N": "white noise: the mean over a time t is this / √t off, the integral this · √t",
    "B": "the floor: averaging for longer does not get below about 0.664 of it",
    "K": "the bias walks: after a time t without looking it is this · √t elsewhere",
    "R": "the bias drifts along a line",
}


_SHORT = ("N", "B", "K")
_LEADS = 3


def meaning(term: str) -> str:
    """What a term means to whoever uses the sensor."""
    return _MEANING[term]


def value_words(value: float, unit: str) -> str:
    """Four digits and the unit."""
    return f"{value:.4g} {unit}"


def duration_words(seconds: float) -> str:
    """A time in the unit a person would use."""
    for size, name in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.3g} s"


def allan_lead(report: AllanReport) -> str:
    """The result in one or two sentences."""
    unit = rate_unit(report.channel)
    if report.best_tau is None or report.best_deviation is None:
        best = "The record is too short to show the best averaging time."
    else:
        best = (
            f"Averaging pays up to {duration_words(report.best_tau)}; what remains then is "
            f"{value_words(report.best_deviation * unit.factor, unit.common)} "
            f"({value_words(report.best_deviation, unit.si)})."
        )
    if report.maytag_stop is not None and is_gyro(report.channel):
        best += f" For maytagging, stops of {duration_words(report.maytag_stop)}"
        best += f" (turns of {report.maytag_turn:g} s)."
    return best


def allan_page(reports: Sequence[Named], title: str, sheets: Sequence[Datasheet] = ()) -> str:
    """The page of one channel, or of several beside each other."""
    if len(reports) == 1:
        _, report = reports[0]
        return page(title, allan_lead(report), allan_sections(report, title, sheets))
    together = Section(
        "Beside each other",
        "Points with 95 % intervals and the fitted sum of the terms. Customary units, 1 sigma.",
        [comparison(reports, sheets)],
        [drawing(lambda: allan_figure(reports, title, sheets))],
    )
    each = [
        Section(f"{name}: {part.title}", part.text, part.tables, part.figures, advice=part.advice)
        for name, report in reports
        for part in allan_sections(report, name, sheets)
    ]
    lead = " ".join(f"{name}: {allan_lead(report)}" for name, report in reports[:_LEADS])
    return page(title, lead, [together, *each])


def comparison(reports: Sequence[Named], sheets: Sequence[Datasheet] = ()) -> Grid:
    """A row for each channel and data sheet: N, B and K in customary units, the best averaging time."""
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
        best = "longer" if report.best_tau is None else duration_words(report.best_tau)
        rows.append((label, *cells, best))
    for sheet in sheets:
        terms = sheet.terms(reports[0][1].channel)
        said = [f"{terms[name] * names[name].factor:.4g}" if name in terms else "" for name in _SHORT]
        rows.append((f"{sheet.name}, data sheet", *said, ""))
    heads = [f"{name} {names[name].name}, {names[name].common}" for name in _SHORT]
    return Grid(("", *heads, "average for"), rows)


def advice(report: AllanReport) -> list[str]:
    """What to do with the result, and to get a better one."""
    lines = []
    white, unit = report.fit.terms["N"], term_units(report.channel)["N"]
    if report.best_tau is not None and report.best_deviation is not None:
        lines.append(
            f"Take the bias from a rest of about {duration_words(report.best_tau)}; longer brings nothing."
        )
    if white.value is not None and is_gyro(report.channel):
        lines.append(
            f"An angle integrated for an hour wanders by {white.value * unit.factor:.4g}° from white noise "
            "alone (1 sigma)."
        )
    hidden = [term for term in report.fit.terms.values() if term.value is None]
    waits = [term.needed for term in hidden if term.needed is not None]
    if waits:
        lines.append(
            f"Record for {duration_words(min(waits))} to see more terms, or to bring their limits down."
        )
    if report.fit.factors[0] > 1:
        lines.append(
            "Give averaging times shorter than the fit's no weight: they show the low-pass. A wider "
            "bandwidth would show quantisation."
        )
    if report.fit.misfit > 0:
        lines.append(
            "The points ripple about the fit: look for vibration or hum near the sensor, and record anew."
        )
    if report.record.excluded:
        lines.append("Something touched the sensor: put it where it is alone, if the cut times repeat.")
    return lines


def terms_grid(report: AllanReport) -> Grid:
    """The terms that the record shows."""
    rows = [
        (
            f"{key} {unit.name}",
            f"{term.value:.4g} ± {term.sigma:.2g} {unit.si}",
            value_words(term.value * unit.factor, unit.common),
            meaning(key),
        )
        for key, unit, term in _terms(report)
        if term.value is not None and term.sigma is not None
    ]
    return Grid(("term", "SI", "customary", "meaning"), rows)


def missing_grid(report: AllanReport) -> Grid:
    """The terms that it cannot show, and why."""
    rows = [
        (
            f"{key} {unit.name}",
            "" if term.limit is None else value_words(term.limit, unit.si),
            "" if term.needed is None else duration_words(term.needed),
            term.reason,
        )
        for key, unit, term in _terms(report)
        if term.value is None or term.sigma is None
    ]
    return Grid(("term", "below (95 %)", "record needed", "why"), rows)


def _terms(report: AllanReport) -> list[tuple[str, TermUnit, NoiseTerm]]:
    return [(key, unit, report.fit.terms[key]) for key, unit in term_units(report.channel).items()]


def allan_sections(
    report: AllanReport, title: str | None = None, sheets: Sequence[Datasheet] = ()
) -> list[Section]:
    """Terms, what to do, figure and an account of the record, for a page. sheets: drawn beside the points."""
    name = title or report.channel
    shown, missing = terms_grid(report), missing_grid(report)
    record = report.record
    account = [
        ("samples", f"{int(np.count_nonzero(record.present))} of {len(record.values)}"),
        ("interval", f"{record.dt:.8g} s"),
        ("duration", duration_words(record.duration)),
        ("gaps", str(len(record.gaps))),
        ("outliers", str(len(record.outliers))),
        ("cut out as disturbed", ", ".join(f"{a:.6g} to {b:.6g} s" for a, b in record.excluded) or "nothing"),
        ("fit", f"chi-square {report.fit.chi2:.4g} for {report.fit.dof} degrees of freedom"),
    ]
    return [
        Section("Noise terms", "IEEE 952 names; 1 sigma.", [shown]),
        Section("What to do", advice=advice(report)),
        Section(
            "Allan deviation",
            "Points with 95 % intervals; the line is the sum of the terms, dashed are their asymptotes. "
            "Below: what the fit leaves over, with 1 sigma; hollow points had no part in it.",
            figures=[drawing(lambda: allan_figure([(name, report)], name, sheets))],
        ),
        *([Section("What this record cannot show", "", [missing])] if missing.rows else []),
        Section("The record", " ".join(f"{note}." for note in report.notes), [Grid(("", ""), account)]),
    ]
