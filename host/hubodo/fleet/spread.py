"""Robust spread of quantities over many logs, outliers with false discovery control, and bias drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import ndtr

from hubodo.arrays import Array

MAX_FALSE_OUTLIER_SHARE = 0.01
"""Maximum expected share of false discoveries among the outliers."""
_MIN_VALUES = 8
"""Minimum number of values of a quantity for outlier detection."""
_MIN_WEEKS = 4
_BIAS_PATTERN = r"bias|\.c2$"
"""Quantities checked for drift; c2 is the bias right after power-on."""
_DRIFT_LEVEL = 0.99
_NORMAL_90_WIDTH_SIGMA = 3.29
"""Width from the 5th to the 95th percentile of a normal distribution, in sigmas."""


@dataclass(frozen=True)
class BiasDrift:
    """The drift of a node's bias: Theil-Sen slope of weekly medians, per week, with its 99 % interval."""

    vehicle: str
    node: str
    quantity: str
    slope: float
    low: float
    high: float
    weeks: int


def robust_sigma(values: Array) -> float:
    """Return the robust standard deviation from the median absolute deviation.

    If that is 0 (mostly equal counts), from the 5th and 95th percentile; 0 if 90 % of values are equal.
    """
    # Imported here because it takes half a second to load and few logs do not need it.
    from scipy.stats import median_abs_deviation

    sigma = float(median_abs_deviation(values, scale="normal"))
    return sigma or float(np.subtract(*np.percentile(values, [95, 5]))) / _NORMAL_90_WIDTH_SIGMA


def normalised_deviations(values: Array, sigmas: Array) -> Array:
    """Return the deviation of each value from the median, in robust sigmas or its own sigma if larger.

    Quantities that are positive throughout are compared by logarithm. NaN if there are too few values.
    """
    if len(values) < _MIN_VALUES:
        return np.full(len(values), np.nan)
    own = np.nan_to_num(sigmas)
    if (values > 0.0).all():
        values, own = np.log(values), own / values
    off = values - np.median(values)
    width = np.maximum(robust_sigma(values), own)
    return np.divide(off, width, out=np.where(off == 0.0, 0.0, np.copysign(np.inf, off)), where=width > 0.0)


def find_outliers(table: pd.DataFrame) -> pd.DataFrame:
    """Return outliers within each verb, quantity and node, farthest first, with column `deviations`.

    The false discovery rate is controlled over all rows (Benjamini and Hochberg), with normal tails.
    """
    numbers = table[table.quantity.notna() & table.p_value.isna() & np.isfinite(table.value)].copy()
    numbers["deviations"] = np.nan
    for _, group in numbers.groupby(["verb", "quantity", "node"]):
        z = normalised_deviations(group.value.to_numpy(float), group.sigma.to_numpy(float))
        numbers.loc[group.index, "deviations"] = z
    numbers = numbers[numbers.deviations.notna()]
    p = 2.0 * ndtr(-numbers.deviations.abs().to_numpy(float))
    outliers = numbers[benjamini_hochberg(p) <= MAX_FALSE_OUTLIER_SHARE]
    order = outliers.deviations.abs().sort_values(ascending=False, kind="stable").index
    return outliers.loc[order]


def benjamini_hochberg(p_values: Array) -> Array:
    """Return the q values of p values (Benjamini and Hochberg 1995, false discovery rate)."""
    if not len(p_values):
        return p_values
    from scipy.stats import false_discovery_control

    q_values: Array = false_discovery_control(p_values, method="bh")
    return q_values


def find_drifts(table: pd.DataFrame) -> list[BiasDrift]:
    """Return biases whose weekly medians drift (Theil-Sen slope, 99 % interval without 0), steepest first."""
    dated = table[table.start.notna() & table.quantity.str.contains(_BIAS_PATTERN, na=False)]
    drifts = []
    for (vehicle, node, quantity), group in dated.groupby(["vehicle", "node", "quantity"]):
        weekly = group.set_index("start").value.resample("W").median().dropna()
        if len(weekly) < _MIN_WEEKS:
            continue
        from scipy.stats import theilslopes

        weeks = (weekly.index - weekly.index[0]).days.to_numpy(float) / 7.0
        slope, _, low, high = theilslopes(weekly.to_numpy(float), weeks, alpha=_DRIFT_LEVEL)
        if low > 0.0 or high < 0.0:
            drifts.append(BiasDrift(vehicle, node, quantity, slope, low, high, len(weekly)))
    return sorted(drifts, key=lambda one: -abs(one.slope))
