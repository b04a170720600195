"""Whiteness tests of a residual: autocorrelation (Barshan and Durrant-Whyte) and Ljung-Box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, chdtrc, ndtr

from hubodo.arrays import Array
from hubodo.errors import InputError

SIGNIFICANCE_LEVEL = 0.005
"""Significance level of each test.

Together the two reject a white residual about once in a hundred records.
"""

# According to the paper, the Gaussian approximation of the autocovariance requires at least 16 samples.
_MIN_TEST_SAMPLES = 16


@dataclass(frozen=True)
class AutocorrelationTest:
    """The ensemble average of the autocorrelation of M sequences of N samples, eq. (2) to (4) of the paper.

    Attributes:
        sequences, length: M and N.
        lags: (L,) lags in samples.
        autocorrelation: (L,) autocorrelation relative to R(0).
        standard_error: 1 / sqrt(M N), the bound of the paper.
        share_within_one_sigma, share_within_two_sigma: share of the lags within one and two standard
            errors.
        expected_share_within_one_sigma, expected_share_within_two_sigma: the same for white noise, whose
            biased estimate has a standard error that decreases with the lag.
        p_value: probability, for white noise, of at least as many lags beyond two of their own standard
            errors.
    """

    sequences: int
    length: int
    lags: NDArray[np.int64]
    autocorrelation: Array
    standard_error: float
    share_within_one_sigma: float
    share_within_two_sigma: float
    expected_share_within_one_sigma: float
    expected_share_within_two_sigma: float
    p_value: float

    @property
    def is_white(self) -> bool:
        return self.p_value > SIGNIFICANCE_LEVEL


@dataclass(frozen=True)
class LjungBox:
    """The Ljung-Box statistic Q = n (n + 2) sum of r_k² / (n - k) over the first `lags` lags.

    n: samples; r_k: autocorrelation at lag k. For a white series Q is chi-square distributed with `lags`
    degrees of freedom.
    """

    statistic: float
    lags: int
    p_value: float

    @property
    def is_white(self) -> bool:
        return self.p_value > SIGNIFICANCE_LEVEL


def autocorrelation_test(residual: Array, sequences: int = 10, length: int = 200) -> AutocorrelationTest:
    """Test the autocorrelation of M sequences of N samples, spread evenly over the residual, as in the paper.

    residual: (n,), zero mean. sequences, length: M and N. The statistic is the biased autocovariance R(k)
    = (1/N) sum w(i) w(i + k), eq. (3), averaged over the sequences and divided by R(0). Its standard error
    is that of eq. (4), R(0) / sqrt(N), divided by sqrt(M). Raises InputError if the residual is constant
    or shorter than 16 samples.
    """
    length = min(length, len(residual))
    sequences = max(1, min(sequences, len(residual) // max(length, 1)))
    if length < _MIN_TEST_SAMPLES or not np.ptp(residual):
        raise InputError(
            f"a whiteness test needs {_MIN_TEST_SAMPLES} samples that are not all equal, there are "
            f"{len(residual)}"
        )
    starts = np.linspace(0, len(residual) - length, sequences).astype(np.int64)
    total = np.mean([_autocovariance(residual[start : start + length]) for start in starts], axis=0)
    lags = np.arange(1, length)
    correlation = total[1:] / total[0]
    error = 1.0 / np.sqrt(sequences * length)
    narrowing = np.sqrt(1.0 - lags / length)
    # The largest tenth of the lags average only a few products and are not Gaussian.
    used = lags <= 0.9 * length
    beyond = int(np.count_nonzero(np.abs(correlation[used]) > 2.0 * error * narrowing[used]))
    share = 2.0 * float(ndtr(-2.0))
    return AutocorrelationTest(
        sequences,
        length,
        lags,
        correlation,
        float(error),
        float(np.mean(np.abs(correlation) <= error)),
        float(np.mean(np.abs(correlation) <= 2.0 * error)),
        float(np.mean(1.0 - 2.0 * ndtr(-1.0 / narrowing))),
        float(np.mean(1.0 - 2.0 * ndtr(-2.0 / narrowing))),
        float(bdtrc(beyond - 1, int(used.sum()), share)),
    )


def ljung_box(residual: Array, lags: int | None = None) -> LjungBox:
    """Apply the test of Ljung and Box (Biometrika 65, 1978) to a residual (n,).

    lags: number of lags, min(20, n / 5) if None. Raises InputError below 16 samples.
    """
    count = len(residual)
    if count < _MIN_TEST_SAMPLES or not np.ptp(residual):
        raise InputError(
            f"a whiteness test needs {_MIN_TEST_SAMPLES} samples that are not all equal, there are {count}"
        )
    used = min(20, count // 5) if lags is None else lags
    centred = residual - residual.mean()
    power = float(centred @ centred)
    r = np.array([float(centred[:-k] @ centred[k:]) for k in range(1, used + 1)]) / power
    statistic = float(count * (count + 2) * np.sum(r**2 / (count - np.arange(1, used + 1))))
    return LjungBox(statistic, used, float(chdtrc(used, statistic)))


def _autocovariance(sequence: Array) -> Array:
    """Return the (N,) biased autocovariance, eq. (3), without the factor 1 / N.

    The mean is not subtracted, because the mean of the residual is part of the test.
    """
    autocovariance: Array = np.correlate(sequence, sequence, "full")[len(sequence) - 1 :]
    return autocovariance
