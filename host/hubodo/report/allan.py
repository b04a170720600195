"""The Allan deviation of a channel as words and tables."""

from __future__ import annotations

import numpy as np

from hubodo.report.allan_figure import allan_figure
from hubodo.report.drawing import drawing
from hubodo.report.page import Grid, Section
from hubodo.sensors.allan.characterise import AllanReport
from hubodo.sensors.allan.ieee952 import is_gyro, rate_unit, units

MEANING = {
    "Q": "steps of the converter; gone after a fraction of a second",
    "N": "white noise: the mean over a time t is this / √t off, the integral this · √t",
    "B": "the floor: averaging for longer does not get below about 0.664 of it",
    "K": "the bias walks: after a time t without looking it is this · √t elsewhere",
    "R": "the bias drifts along a line",
}


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
            f"{value_words(report.best_deviation * unit.factor, unit.customary)} "
            f"({value_words(report.best_deviation, unit.si)})."
        )
    if report.stop is not None and is_gyro(report.channel):
        best += f" For maytagging, stops of {duration_words(report.stop)} (turns of {report.turn:g} s)."
    return best


def allan_sections(report: AllanReport) -> list[Section]:
    """Terms, figure and an account of the record, for a page."""
    names = units(report.channel)
    rows, missing = [], []
    for name, unit in names.items():
        term = report.fit.terms[name]
        if term.value is None or term.sigma is None:
            limit = "" if term.limit is None else value_words(term.limit, unit.si)
            needed = "" if term.needed is None else duration_words(term.needed)
            missing.append((f"{name} {unit.name}", limit, needed, term.reason))
        else:
            rows.append(
                (
                    f"{name} {unit.name}",
                    f"{term.value:.4g} ± {term.sigma:.2g} {unit.si}",
                    value_words(term.value * unit.factor, unit.customary),
                    MEANING[name],
                )
            )
    record = report.record
    account = [
        ("samples", f"{int(np.count_nonzero(record.present))} of {len(record.values)}"),
        ("interval", f"{record.dt:.8g} s"),
        ("duration", duration_words(record.duration)),
        ("gaps", str(len(record.gaps))),
        ("outliers", str(len(record.outliers))),
        ("fit", f"chi-square {report.fit.chi2:.4g} for {report.fit.dof} degrees of freedom"),
    ]
    return [
        Section(
            "Noise terms", "IEEE 952 names; 1 sigma.", [Grid(("term", "SI", "customary", "meaning"), rows)]
        ),
        Section(
            "Allan deviation",
            "Points with 95 % intervals; the line is the sum of the terms, dashed are their asymptotes. "
            "Below: what the fit leaves over, with 1 sigma; hollow points had no part in it.",
            figures=[drawing(lambda: allan_figure([(report.channel, report)], report.channel))],
        ),
        *(
            [
                Section(
                    "What this record cannot show",
                    "",
                    [Grid(("term", "below (95 %)", "record needed", "why"), missing)],
                )
            ]
            if missing
            else []
        ),
        Section("The record", " ".join(f"{note}." for note in report.notes), [Grid(("", ""), account)]),
    ]
