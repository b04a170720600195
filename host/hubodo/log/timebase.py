"""Seconds in a table to nanoseconds in a log and back, with no rounding that the way back does not undo."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from hubodo.units import NS_PER_S

MAX_EXACT_S = 2**53 / NS_PER_S
"""s; from here on (104 days) float64 does not hold every ns."""

_DECIMAL = re.compile(rb"\s*([+-]?)(\d{1,10})(?:\.(\d{0,9})0*)?\s*")


def to_ns(t: NDArray[np.float64], t_zero_ns: int) -> NDArray[np.int64]:
    """Nearest whole ns, (N,), of t seconds after t_zero_ns."""
    whole = np.floor(t)
    # t - whole is exact in binary, so only the last product rounds.
    return whole.astype(np.int64) * NS_PER_S + np.rint((t - whole) * NS_PER_S).astype(np.int64) + t_zero_ns


def to_seconds(t_ns: NDArray[np.int64], t_zero_ns: int) -> NDArray[np.float64]:
    """Seconds after t_zero_ns, (N,): for each count of ns the float64 nearest to that decimal fraction."""
    since = t_ns - t_zero_ns
    # Below 2^53 ns the division rounds once; above, extended precision finds the right neighbour.
    if len(since) and int(np.abs(since).max()) >= 1 << 53:
        return (since.astype(np.longdouble) / NS_PER_S).astype(np.float64)
    return since / NS_PER_S


def round_trips_exactly(t: NDArray[np.float64], t_zero_ns: int) -> bool:
    """Whether each t comes back to the last bit from its ns, and no two share one."""
    t_ns = to_ns(t, t_zero_ns)
    back = to_seconds(t_ns, t_zero_ns)
    same = back.view(np.int64) == np.ascontiguousarray(t).view(np.int64)
    return bool(same.all())


def parse_decimal_seconds(texts: Iterable[bytes]) -> NDArray[np.int64] | None:
    """Exact ns of decimal seconds; None when one of them is no plain decimal of at most nine places."""
    times_ns = []
    for text in texts:
        match = _DECIMAL.fullmatch(text)
        if match is None:
            return None
        ns = int(match[2]) * NS_PER_S + int((match[3] or b"").ljust(9, b"0"))
        times_ns.append(-ns if match[1] == b"-" else ns)
    return np.array(times_ns, np.int64)


def format_decimal_seconds(t_ns: int) -> str:
    """Decimal seconds, exact, without closing zeros."""
    whole, rest = divmod(abs(t_ns), NS_PER_S)
    sign = "-" if t_ns < 0 else ""
    return f"{sign}{whole}.{rest:09d}".rstrip("0").removesuffix(".")
