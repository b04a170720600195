"""How numbers of many logs spread, which of them stand out, and which wander as weeks go by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import ndtr

from hubodo.arrays import Array

FALSE_SHARE = 0.01
"""Of the logs named as outliers so many are named by chance, at the most, on average."""
_FEWEST = 8
"""Values of a quantity below which nothing is said to stand out."""
_FEWEST_WEEKS = 4
_BIAS = r"bias|\.c2$"
"""C2 is the bias right after power-on."""
_DRIFT_LEVEL = 0.99
_NORMAL_90 = 3.29
"""Width from the 5th to the 95th percentile of a normal distribution, in sigmas."""


@dataclass(frozen=True)
class BiasDrift:
    """A straight line through weekly medians of a node's bias. slope: per week; low, high: 99 % interval."""

    vehicle: str
    node: str
    quantity: str
    slope: float
    low: float
    high: float
    weeks: int


def robust_sigma(values: Array) -> float:
    """Standard deviation of the bulk, from the median absolute deviation.

    Of counts that are mostly the same from the 5th and 95th percentile; 0 where nine in ten are equal.
    """
    # Half a second to load: of few logs, of which nothing can be said, nobody waits for it.
    from scipy.stats import median_abs_deviation

    sigma = float(median_abs_deviation(values, scale="normal"))
    return sigma or float(np.subtract(*np.percentile(values, [95, 5]))) / _NORMAL_90


def deviations(values: Array, sigmas: Array) -> Array:
    """Of each value from the median, in sigmas of the bulk, or in its own where that is larger.

    Of what is positive throughout the ratio counts, not the difference. NaN where there are too few.
    """
    if len(values) < _FEWEST:
        return np.full(len(values), np.nan)
    own = np.nan_to_num(sigmas)
    if (values > 0.0).all():
        values, own = np.log(values), own / values
    off = values - np.median(values)
    width = np.maximum(robust_sigma(values), own)
    return np.divide(off, width, out=np.where(off == 0.0, 0.0, np.copysign(np.inf, off)), where=width > 0.0)


def outliers(table: pd.DataFrame) -> pd.DataFrame:
    """The rows that stand out among their verb, quantity and node's, the farthest first, with `deviations`.

    False discoveries are controlled over all rows (Benjamini and Hochberg), tails taken as normal.
    """
    numbers = table[table.quantity.notna() & table.p_value.isna() & np.isfinite(table.value)].copy()
    numbers["deviations"] = np.nan
    for _, group in numbers.groupby(["verb", "quantity", "node"]):
        z = deviations(group.value.to_numpy(float), group.sigma.to_numpy(float))
        numbers.loc[group.index, "deviations"] = z
    numbers = numbers[numbers.deviations.notna()]
    p = 2.0 * ndtr(-numbers.deviations.abs().to_numpy(float))
    found = numbers[adjusted(p) <= FALSE_SHARE]
    order = found.deviations.abs().sort_values(ascending=False, kind="stable").index
    return found.loc[order]


def adjusted(p_values: Array) -> Array:
    """Benjamini and Hochberg: share of false discoveries if all up to each were believed; q values."""
    if not len(p_values):
        return p_values
    from scipy.stats import false_discovery_control

    made: Array = false_discovery_control(p_values, method="bh")
    return made


def drifts(table: pd.DataFrame) -> list[BiasDrift]:
    """Biases whose weekly medians go one way (Theil and Sen, 99 % interval without zero), steepest first."""
    dated = table[table.start.notna() & table.quantity.str.contains(_BIAS, na=False)]
    found = []
    for (vehicle, node, quantity), group in dated.groupby(["vehicle", "node", "quantity"]):
        weekly = group.set_index("start").value.resample("W").median().dropna()
        if len(weekly) < _FEWEST_WEEKS:
            continue
        from scipy.stats import theilslopes

        weeks = (weekly.index - weekly.index[0]).days.to_numpy(float) / 7.0
        slope, _, low, high = theilslopes(weekly.to_numpy(float), weeks, alpha=_DRIFT_LEVEL)
        if low > 0.0 or high < 0.0:
            found.append(BiasDrift(vehicle, node, quantity, slope, low, high, len(weekly)))
    return sorted(found, key=lambda one: -abs(one.slope))
