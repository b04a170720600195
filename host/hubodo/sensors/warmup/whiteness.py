"""Is a residual white? In the autocorrelation domain as Barshan and Durrant-Whyte do, and by Ljung-Box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, chdtrc, ndtr

from hubodo.errors import InputError

FloatArray = NDArray[np.float64]

ALPHA = 0.005
"""Two tests at this level each call a white residual not white about once in a hundred records."""

# The paper: the Gaussian approximation of the autocovariance holds from 16 samples on.
_FEWEST = 16


@dataclass(frozen=True)
class AutocorrelationTest:
    """Ensemble average of the autocorrelation of M sequences, eq. (2) to (4) of the paper.

    lags: (L,) samples. autocorrelation: (L,) of R(0). standard_error: 1 / sqrt(M N), the paper's bound.
    inside_one, inside_two: share of the lags within one and two of it; expected_one, expected_two: what white
    noise would give (the biased estimate narrows with the lag). p_value: of as many lags or more beyond two
    standard errors of their own.
    """

    sequences: int
    length: int
    lags: NDArray[np.int64]
    autocorrelation: FloatArray
    standard_error: float
    inside_one: float
    inside_two: float
    expected_one: float
    expected_two: float
    p_value: float

    @property
    def white(self) -> bool:
        return self.p_value > ALPHA


@dataclass(frozen=True)
class LjungBox:
    """Q = n (n + 2) sum of r_k² / (n - k) over the first lags.

    Chi-square with as many degrees for a white series.
    """

    statistic: float
    lags: int
    p_value: float

    @property
    def white(self) -> bool:
        return self.p_value > ALPHA


def autocorrelation_test(residual: FloatArray, sequences: int = 10, length: int = 200) -> AutocorrelationTest:
    """The paper's test on M sequences of N samples spread evenly over the residual.

    residual: (n,), zero mean. The biased autocovariance R(k) = (1/N) sum w(i) w(i + k) of each sequence, eq.
    (3); their mean over the sequences, divided by R(0); standard error R(0) / sqrt(N), eq. (4), over sqrt(M).
    Raises InputError when the residual is shorter than 16 samples or constant.
    """
    length = min(length, len(residual))
    sequences = max(1, min(sequences, len(residual) // max(length, 1)))
    if length < _FEWEST or not np.ptp(residual):
        raise InputError(
            f"a whiteness test needs {_FEWEST} samples that are not all equal, there are {len(residual)}"
        )
    starts = np.linspace(0, len(residual) - length, sequences).astype(np.int64)
    total = np.mean([_autocovariance(residual[start : start + length]) for start in starts], axis=0)
    lags = np.arange(1, length)
    found = total[1:] / total[0]
    error = 1.0 / np.sqrt(sequences * length)
    narrowing = np.sqrt(1.0 - lags / length)
    # The last tenth of the lags rests on a handful of products each, which are not Gaussian.
    judged = lags <= 0.9 * length
    beyond = int(np.count_nonzero(np.abs(found[judged]) > 2.0 * error * narrowing[judged]))
    share = 2.0 * float(ndtr(-2.0))
    return AutocorrelationTest(
        sequences,
        length,
        lags,
        found,
        float(error),
        float(np.mean(np.abs(found) <= error)),
        float(np.mean(np.abs(found) <= 2.0 * error)),
        float(np.mean(1.0 - 2.0 * ndtr(-1.0 / narrowing))),
        float(np.mean(1.0 - 2.0 * ndtr(-2.0 / narrowing))),
        float(bdtrc(beyond - 1, int(judged.sum()), share)),
    )


def ljung_box(residual: FloatArray, lags: int | None = None) -> LjungBox:
    """The test of Ljung and Box (Biometrika 65, 1978).

    lags: min(20, n / 5) where None. Raises InputError below 16 samples.
    """
    count = len(residual)
    if count < _FEWEST or not np.ptp(residual):
        raise InputError(
            f"a whiteness test needs {_FEWEST} samples that are not all equal, there are {count}"
        )
    used = min(20, count // 5) if lags is None else lags
    centred = residual - residual.mean()
    power = float(centred @ centred)
    r = np.array([float(centred[:-k] @ centred[k:]) for k in range(1, used + 1)]) / power
    statistic = float(count * (count + 2) * np.sum(r**2 / (count - np.arange(1, used + 1))))
    return LjungBox(statistic, used, float(chdtrc(used, statistic)))


def _autocovariance(sequence: FloatArray) -> FloatArray:
    """(N,) biased autocovariance, eq. (3), but for its factor 1 / N.

    The mean is not taken off: the residual's own mean is part of the test.
    """
    made: FloatArray = np.correlate(sequence, sequence, "full")[len(sequence) - 1 :]
    return made
