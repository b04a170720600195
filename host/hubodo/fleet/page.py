"""Build the fleet page: distributions of biases, noise and gaps by node and date, and outliers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from hubodo.fleet.figures import effect_map, spread_figure
from hubodo.fleet.missing_effects import GAP_VERB, MAX_FALSE_EFFECT_SHARE, list_missing_effects, weekly_shares
from hubodo.fleet.quantities import MISSING_EFFECT_PREFIX
from hubodo.fleet.spread import find_drifts, find_outliers
from hubodo.pages.drawing import Drawing
from hubodo.pages.page import PageTable, Section, render_page

_MAX_TABLE_ROWS = 40
_MAX_FIGURES = 12
_SUBJECT_PATTERNS = (
    ("Gaps and losses", ("gaps", "missing_share", "longest_gap", "jitter", "rate", "damaged")),
    ("Bias", ("bias", ".c2")),
    ("Noise: Allan coefficients", (".N", ".B", ".K", ".R", ".Q", ".smallest_deviation")),
    ("Warm-up", (".c1", ".time_constant", ".white")),
    ("Odometry", ("truth.", "distance")),
    ("Gap to the model", ("gap.",)),
)
_MIN_FIGURE_VALUES = 10
_DRIVE_COLUMNS = (
    ("distance", "distance", "m"),
    ("truth.final_error", "final error", "m"),
    ("truth.final_percent", "final error", "% of the path"),
    ("truth.rms_error", "rms error", "m"),
    ("truth.maximum_error", "largest error", "m"),
)
"""Quantity, heading and unit of the table of drives."""
_OTHER_SUBJECT = "Other quantities"


def build_fleet_page(table: pd.DataFrame) -> str:
    """Return the HTML page of a fleet. table: as `table.parquet`."""
    logs = table.drop_duplicates(["verb", "log"])
    numbers = table[
        np.isfinite(table.value) & ~table.quantity.str.startswith(MISSING_EFFECT_PREFIX, na=False)
    ]
    sections = [
        _vehicle_section(logs),
        *_drives_section(table),
        *_without_result_section(logs),
        *_outlier_section(table),
    ]
    sections += [*_missing_effects_section(table), *_drift_section(table)]
    subject = numbers.quantity.map(_subject_of)
    for title in (*(name for name, _ in _SUBJECT_PATTERNS), _OTHER_SUBJECT):
        sections += _spread_section(title, numbers[subject == title])
    return render_page("Fleet", _overview_text(logs), sections)


def _overview_text(logs: pd.DataFrame) -> str:
    dates = logs.start.dropna()
    span = f", {dates.min():%Y-%m-%d} to {dates.max():%Y-%m-%d}" if len(dates) else ""
    without = int((logs.status != "done").sum())
    text = f"{_count(logs.log.nunique(), 'log')} of {_count(logs.vehicle.nunique(), 'vehicle')}{span}; "
    return text + (f"{without} analyses without a result." if without else "each has its result.")


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("s" if number != 1 else "")


def _vehicle_section(logs: pd.DataFrame) -> Section:
    rows = []
    for (vehicle, verb), group in logs.groupby(["vehicle", "verb"]):
        dates = group.start.dropna()
        span = (f"{dates.min():%Y-%m-%d}", f"{dates.max():%Y-%m-%d}") if len(dates) else ("", "")
        counts = [str(int((group.status == status).sum())) for status in ("done", "refused", "failed")]
        rows.append((vehicle, verb, *counts, f"{group['size'].sum() / 1e9:.3f}", *span))
    heads: tuple[str, ...] = ("vehicle", "verb", "done", "refused", "failed", "GB", "first", "last")
    if not any(row[-1] for row in rows):  # no log has a date
        heads, rows = heads[:-2], [row[:-2] for row in rows]
    return Section("Vehicles", _describe_truncation(rows), [PageTable(heads, rows[:_MAX_TABLE_ROWS])])


def _without_result_section(logs: pd.DataFrame) -> Iterator[Section]:
    rows = [(row.log, row.verb, row.error) for row in logs[logs.status != "done"].itertuples()]
    if rows:
        yield Section(
            "Without a result",
            _describe_truncation(rows),
            [PageTable(("log", "verb", "why"), rows[:_MAX_TABLE_ROWS])],
        )


def _outlier_section(table: pd.DataFrame) -> Iterator[Section]:
    outliers = find_outliers(table)
    if not len(outliers):
        return
    rows = [
        (
            row.log,
            row.node,
            f"{row.verb} {row.quantity}",
            _format_value(row.value, row.unit),
            f"{row.deviations:+.1f}" if math.isfinite(row.deviations) else "all others are equal",
        )
        for row in outliers.itertuples()
    ]
    heads = ("log", "node", "quantity", "value", "deviation from the median, sigma")
    text = "Sigma: robust spread of all logs, or the value's own if larger; false discovery rate 1 %. "
    yield Section("Outliers", text + _describe_truncation(rows), [PageTable(heads, rows[:_MAX_TABLE_ROWS])])


def _missing_effects_section(table: pd.DataFrame) -> Iterator[Section]:
    if not (table.verb == GAP_VERB).any():
        return
    missing = list_missing_effects(table)
    rows = [
        (
            one.effect,
            one.scope,
            one.vehicle,
            f"{one.logs} of {one.examined_logs}",
            f"{one.since:%Y-%m-%d}" if one.since else "",
        )
        for one in missing
    ]
    effects = list(dict.fromkeys(one.effect for one in missing))
    counts = ", ".join(
        f"{name} in {len({one.vehicle for one in missing if one.effect == name})}" for name in effects
    )
    text = f"Vehicles: {counts or 'none'}. " + _describe_truncation(rows)
    text += f" False discovery rate {100 * MAX_FALSE_EFFECT_SHARE:.0f} % (Benjamini and Hochberg)."
    heads = ("effect", "of", "vehicle", "logs", "since week of")
    share = {name: weekly_shares(table, name) for name in effects[:_MAX_FIGURES]}
    maps = [effect_map(some, name) for name, some in share.items() if some.size]
    yield Section("Effects missing in the model", text, [PageTable(heads, rows[:_MAX_TABLE_ROWS])], maps)


def _drift_section(table: pd.DataFrame) -> Iterator[Section]:
    rows = [
        (
            one.vehicle,
            one.node,
            one.quantity,
            f"{one.slope:+.3g}",
            f"{one.low:+.3g} to {one.high:+.3g}",
            str(one.weeks),
        )
        for one in find_drifts(table)
    ]
    if rows:
        heads = ("vehicle", "node", "quantity", "SI per week", "99 %", "weeks")
        yield Section(
            "Biases that drift", _describe_truncation(rows), [PageTable(heads, rows[:_MAX_TABLE_ROWS])]
        )


def _spread_section(title: str, numbers: pd.DataFrame) -> Iterator[Section]:
    if not len(numbers):
        return
    rows: list[tuple[str, ...]] = []
    figures: list[Drawing] = []
    for (verb, quantity), group in numbers.groupby(["verb", "quantity"]):
        unit = group.unit.iloc[0]
        if len(figures) < _MAX_FIGURES and _deserves_figure(group):
            figures.append(spread_figure(group, f"{quantity}, {unit}" if unit else quantity))
        for node, part in group.groupby("node"):
            shares_of = np.percentile(part.value, [5, 50, 95])
            rows.append(
                (
                    f"{verb} {quantity}",
                    node or "log",
                    unit or "1",
                    str(len(part)),
                    *(f"{value:.3g}" for value in shares_of),
                )
            )
    heads = ("quantity", "node", "unit", "logs", "5 %", "median", "95 %")
    yield Section(
        title,
        _describe_truncation(rows),
        [PageTable(heads, rows[:_MAX_TABLE_ROWS])],
        figures,
        is_folded=title == _OTHER_SUBJECT,
    )


def _deserves_figure(group: pd.DataFrame) -> bool:
    """Return True if a quantity has enough different values for a histogram and a curve over days."""
    return group.value.nunique() > 2 and len(group) >= _MIN_FIGURE_VALUES


def _drives_section(table: pd.DataFrame) -> Iterator[Section]:
    """Yield a table of the distance and the errors of each log that `fuse` has processed."""
    drives = table[(table.verb == "fuse") & np.isfinite(table.value)]
    if drives.empty:
        return
    by_log = drives.pivot_table(index="log", columns="quantity", values="value", aggfunc="first")
    columns = [name for name, _, _ in _DRIVE_COLUMNS if name in by_log]
    rows = [(str(log), *(_format_cell(row[name]) for name in columns)) for log, row in by_log.iterrows()]
    heads = ("log", *(f"{title}, {unit}" for name, title, unit in _DRIVE_COLUMNS if name in columns))
    yield Section("Drives", _describe_truncation(rows), [PageTable(heads, rows[:_MAX_TABLE_ROWS])])


def _format_cell(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else ""


def _subject_of(quantity: str) -> str:
    for title, words in _SUBJECT_PATTERNS:
        if any(word in quantity if word[0] != "." else quantity.endswith(word) for word in words):
            return title
    return _OTHER_SUBJECT


def _format_value(value: float, unit: str) -> str:
    return f"{value:.5g} {unit}".rstrip()


def _describe_truncation(rows: Sequence[tuple[str, ...]]) -> str:
    return f"The first {_MAX_TABLE_ROWS} of {len(rows)} rows." if len(rows) > _MAX_TABLE_ROWS else ""
