"""The page of a fleet: how biases, noise and gaps spread by node and date, and which logs stand out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from hubodo.fleet.figures import effect_map, spread_figure
from hubodo.fleet.missing_effects import FALSE_SHARE, VERB, missing_effects, shares
from hubodo.fleet.quantities import FOUND
from hubodo.fleet.spread import drifts, outliers
from hubodo.report.drawing import Drawing
from hubodo.report.page import Grid, Section, page

_MOST_ROWS = 40
_MOST_FIGURES = 12
_SUBJECTS = (
    ("Gaps and losses", ("gaps", "missing_share", "longest_gap", "jitter", "rate", "damaged")),
    ("Bias", ("bias", ".c2")),
    ("Noise: Allan coefficients", (".N", ".B", ".K", ".R", ".Q", ".smallest_deviation")),
    ("Warm-up", (".c1", ".time_constant", ".white")),
    ("Odometry", ("truth.", "distance")),
    ("Gap to the model", ("gap.",)),
)
_REST = "Other quantities"


def fleet_page(table: pd.DataFrame) -> str:
    """table: as `table.parquet`."""
    logs = table.drop_duplicates(["verb", "log"])
    numbers = table[np.isfinite(table.value) & ~table.quantity.str.startswith(FOUND, na=False)]
    sections = [_vehicles(logs), *_without_result(logs), *_outliers(table)]
    sections += [*_missing(table), *_drifts(table)]
    subject = numbers.quantity.map(_subject)
    for title in (*(name for name, _ in _SUBJECTS), _REST):
        sections += _spread(title, numbers[subject == title])
    return page("Fleet", _lead(logs), sections)


def _lead(logs: pd.DataFrame) -> str:
    dates = logs.start.dropna()
    span = f", {dates.min():%Y-%m-%d} to {dates.max():%Y-%m-%d}" if len(dates) else ""
    without = int((logs.status != "done").sum())
    text = f"{logs.log.nunique()} logs of {logs.vehicle.nunique()} vehicles{span}; "
    return text + (f"{without} analyses without a result." if without else "each has its result.")


def _vehicles(logs: pd.DataFrame) -> Section:
    rows = []
    for (vehicle, verb), group in logs.groupby(["vehicle", "verb"]):
        dates = group.start.dropna()
        span = (f"{dates.min():%Y-%m-%d}", f"{dates.max():%Y-%m-%d}") if len(dates) else ("", "")
        counts = [str(int((group.status == status).sum())) for status in ("done", "refused", "failed")]
        rows.append((vehicle, verb, *counts, f"{group['size'].sum() / 1e9:.3f}", *span))
    heads = ("vehicle", "verb", "done", "refused", "failed", "GB", "first", "last")
    return Section("Vehicles", _more(rows), [Grid(heads, rows[:_MOST_ROWS])])


def _without_result(logs: pd.DataFrame) -> Iterator[Section]:
    rows = [(row.log, row.verb, row.error) for row in logs[logs.status != "done"].itertuples()]
    if rows:
        yield Section("Without a result", _more(rows), [Grid(("log", "verb", "why"), rows[:_MOST_ROWS])])


def _outliers(table: pd.DataFrame) -> Iterator[Section]:
    found = outliers(table)
    if not len(found):
        return
    rows = [
        (
            row.log,
            row.node,
            f"{row.verb} {row.quantity}",
            _value(row.value, row.unit),
            f"{row.deviations:+.1f}" if math.isfinite(row.deviations) else "all others are alike",
        )
        for row in found.itertuples()
    ]
    heads = ("log", "node", "quantity", "value", "sigmas off the median")
    text = "Sigmas of the bulk of all logs, or the value's own where that is larger; 1 % of them by chance. "
    yield Section("Logs that stand out", text + _more(rows), [Grid(heads, rows[:_MOST_ROWS])])


def _missing(table: pd.DataFrame) -> Iterator[Section]:
    if not (table.verb == VERB).any():
        return
    found = missing_effects(table)
    rows = [
        (
            one.effect,
            one.scope,
            one.vehicle,
            f"{one.logs} of {one.of}",
            f"{one.since:%Y-%m-%d}" if one.since else "",
        )
        for one in found
    ]
    effects = list(dict.fromkeys(one.effect for one in found))
    counts = ", ".join(
        f"{name} in {len({one.vehicle for one in found if one.effect == name})}" for name in effects
    )
    text = f"Vehicles: {counts or 'none'}. " + _more(rows)
    text += f" At most {100 * FALSE_SHARE:.0f} % of these findings are chance (Benjamini and Hochberg)."
    heads = ("effect", "of", "vehicle", "logs", "since the week of")
    share = {name: shares(table, name) for name in effects[:_MOST_FIGURES]}
    maps = [effect_map(some, name) for name, some in share.items() if some.size]
    yield Section("What the model lacks", text, [Grid(heads, rows[:_MOST_ROWS])], maps)


def _drifts(table: pd.DataFrame) -> Iterator[Section]:
    rows = [
        (
            one.vehicle,
            one.node,
            one.quantity,
            f"{one.slope:+.3g}",
            f"{one.low:+.3g} to {one.high:+.3g}",
            str(one.weeks),
        )
        for one in drifts(table)
    ]
    if rows:
        heads = ("vehicle", "node", "quantity", "SI per week", "99 %", "weeks")
        yield Section("Biases that drift", _more(rows), [Grid(heads, rows[:_MOST_ROWS])])


def _spread(title: str, numbers: pd.DataFrame) -> Iterator[Section]:
    if not len(numbers):
        return
    rows: list[tuple[str, ...]] = []
    figures: list[Drawing] = []
    for (verb, quantity), group in numbers.groupby(["verb", "quantity"]):
        unit = group.unit.iloc[0]
        if len(figures) < _MOST_FIGURES and group.value.nunique() > 1:
            figures.append(spread_figure(group, f"{quantity}, {unit}" if unit else quantity))
        for node, part in group.groupby("node"):
            shares_of = np.percentile(part.value, [5, 50, 95])
            rows.append(
                (f"{verb} {quantity}", node, unit, str(len(part)), *(f"{value:.4g}" for value in shares_of))
            )
    heads = ("quantity", "node", "unit", "logs", "5 %", "median", "95 %")
    yield Section(title, _more(rows), [Grid(heads, rows[:_MOST_ROWS])], figures)


def _subject(quantity: str) -> str:
    for title, words in _SUBJECTS:
        if any(word in quantity if word[0] != "." else quantity.endswith(word) for word in words):
            return title
    return _REST


def _value(value: float, unit: str) -> str:
    return f"{value:.5g} {unit}".rstrip()


def _more(rows: Sequence[tuple[str, ...]]) -> str:
    return f"The first {_MOST_ROWS} of {len(rows)} rows." if len(rows) > _MOST_ROWS else ""
