"""Dates and times of day in text, as seconds."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from hubodo.arrays import Array

_EPOCH, _MICROSECOND = datetime(1970, 1, 1, tzinfo=UTC), timedelta(microseconds=1)
_DAY_S = 86_400.0
_DATE = re.compile(r"(\d{1,4})([./-])(\d{1,2})\2(\d{1,4})")
_TIME = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d{1,9}))?)?\s*([AaPp][Mm])?")
_YEAR_DIGITS = 4


@dataclass(frozen=True)
class ClockFormat:
    """The format of a column with dates, times of day, or both.

    order: of the parts of a date, as in "dmy"; "iso" for ISO 8601; "" if there is no date, or if day and
    month cannot be distinguished. The time then counts from midnight of the first day.
    has_time: False for dates alone.
    """

    order: str
    has_time: bool

    def seconds(self, cell: str) -> str:
        """Return a cell as seconds since 1970 in UTC or, without a date, since midnight; else unchanged."""
        elapsed = self._elapsed(cell)
        if elapsed is None:
            return cell
        return f"{elapsed // _MICROSECOND}e-6" if self.order or self.has_time else "nan"

    def _elapsed(self, cell: str) -> timedelta | None:
        if self.order == "iso":
            return _iso_date(cell)
        date, _, time = cell.replace("T", " ").partition(" ") if _DATE.match(cell) else ("", "", cell)
        days = _days(date, self.order or "dmy") if date else timedelta(0)
        of_day = _time_of_day(time.strip()) if self.has_time else timedelta(0)
        if days is None or of_day is None:
            return None
        return days + of_day if self.order else of_day


def clock_format(cell: str) -> ClockFormat | None:
    """Return the format of a date, a time of day or both; None for other text.

    With slashes or hyphens, the order of day and month is known only if one of them is above 12.
    """
    if not cell.isdigit() and _iso_date(cell) is not None:
        return ClockFormat("iso", has_time=":" in cell)
    if _time_of_day(cell) is not None:
        return ClockFormat("", has_time=True)
    date, _, time = cell.replace("T", " ").partition(" ")
    match = _DATE.fullmatch(date)
    if match is None or (time and _time_of_day(time.strip()) is None):
        return None
    orders = [order for order in ("ymd", "dmy", "mdy") if _days(date, order) is not None]
    if match[2] == "." and "dmy" in orders:
        orders = ["dmy"]
    if not orders:
        return None
    return ClockFormat(orders[0] if len(orders) == 1 else "", has_time=bool(time))


def join_dates_and_times(values: Array, formats: Mapping[int, ClockFormat]) -> None:
    """Add the column of dates, in place, to that of times of day; without one count days by midnights."""
    dates = [column for column, its in formats.items() if its.order and not its.has_time]
    times = [column for column, its in formats.items() if its.has_time and not its.order]
    for column in times:
        if len(dates) == 1:
            values[:, column] += values[:, dates[0]]
        else:
            midnights = np.diff(values[:, column], prepend=values[:1, column]) < -_DAY_S / 2
            values[:, column] += _DAY_S * np.cumsum(midnights)


def _iso_date(cell: str) -> timedelta | None:
    try:
        date = datetime.fromisoformat(cell)
    except ValueError:
        return None
    return (date if date.tzinfo else date.replace(tzinfo=UTC)) - _EPOCH


def _days(date: str, order: str) -> timedelta | None:
    """Return the days since 1970 of a date whose parts have this order; None if it is no date."""
    match = _DATE.fullmatch(date)
    if match is None:
        return None
    parts = dict(zip(order, (match[1], match[3], match[4]), strict=True))
    if len(parts["y"]) != _YEAR_DIGITS:
        return None
    try:
        return datetime(int(parts["y"]), int(parts["m"]), int(parts["d"]), tzinfo=UTC) - _EPOCH
    except ValueError:
        return None


def _time_of_day(cell: str) -> timedelta | None:
    match = _TIME.fullmatch(cell)
    if match is None:
        return None
    hours, minutes, seconds = int(match[1]), int(match[2]), int(match[3] or 0)
    if match[5]:
        if not 1 <= hours <= 12:
            return None
        hours = hours % 12 + (12 if match[5].lower() == "pm" else 0)
    if hours > 23 or minutes > 59 or seconds > 60:
        return None
    microseconds = round(float(f"0.{match[4] or 0}") * 1e6)
    return timedelta(hours=hours, minutes=minutes, seconds=seconds, microseconds=microseconds)
