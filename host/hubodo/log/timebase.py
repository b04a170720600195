"""Convert between seconds in a table and nanoseconds in a log without losing precision."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from hubodo.units import NS_PER_S

MAX_EXACT_S = 2.0**23
"""s; from this time on (97 days) the spacing of float64 exceeds 1 ns."""

_DECIMAL = re.compile(rb"\s*([+-]?)(\d{1,10})(?:\.(\d{0,9})0*)?\s*")


def to_ns(t: NDArray[np.float64], t_zero_ns: int) -> NDArray[np.int64]:
    """Return the nearest whole ns, (N,), for t seconds after t_zero_ns."""
    whole = np.floor(t)
    # t - whole is exact in binary, so only the last product rounds.
    return whole.astype(np.int64) * NS_PER_S + np.rint((t - whole) * NS_PER_S).astype(np.int64) + t_zero_ns


def to_seconds(t_ns: NDArray[np.int64], t_zero_ns: int) -> NDArray[np.float64]:
    """Return seconds after t_zero_ns, (N,): for each time in ns the nearest float64."""
    since = t_ns - t_zero_ns
    # Below 2^53 ns the division rounds once; above, extended precision gives the nearest float64.
    if len(since) and int(np.abs(since).max()) >= 1 << 53:
        return (since.astype(np.longdouble) / NS_PER_S).astype(np.float64)
    return since / NS_PER_S


def round_trips_exactly(t: NDArray[np.float64], t_zero_ns: int) -> bool:
    """Return True if each t converts to ns and back to the same bits."""
    t_ns = to_ns(t, t_zero_ns)
    back = to_seconds(t_ns, t_zero_ns)
    same = back.view(np.int64) == np.ascontiguousarray(t).view(np.int64)
    return bool(same.all())


def parse_decimal_seconds(texts: Iterable[bytes]) -> NDArray[np.int64] | None:
    """Return exact ns of decimal seconds; None if one is not a plain decimal of at most nine places."""
    times_ns = []
    for text in texts:
        match = _DECIMAL.fullmatch(text)
        if match is None:
            return None
        ns = int(match[2]) * NS_PER_S + int((match[3] or b"").ljust(9, b"0"))
        times_ns.append(-ns if match[1] == b"-" else ns)
    return np.array(times_ns, np.int64)


def format_decimal_seconds(t_ns: int) -> str:
    """Format ns as exact decimal seconds without trailing zeros."""
    seconds, fraction_ns = divmod(abs(t_ns), NS_PER_S)
    sign = "-" if t_ns < 0 else ""
    return f"{sign}{seconds}.{fraction_ns:09d}".rstrip("0").removesuffix(".")
