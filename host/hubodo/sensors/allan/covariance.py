"""Covariance of overlapping Allan variances, for any mixture of the five noise terms of IEEE 952."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

TERMS = ("Q", "N", "B", "K", "R")
"""Quantisation, angle random walk, bias instability, rate random walk, rate ramp (IEEE 952)."""

# The covariance is a sum over lags; the summand is smooth except at kinks where the edges of two windows
# meet. The sum uses this many lags per shorter window around the kinks, and per longer window in between.
_LAGS_PER_WINDOW = 12
_KINK_REACH_WINDOWS = 3
# Largest lag in units of the combined window length. White noise and random walk vanish beyond 1; the
# correlation of flicker noise falls as lag^-2, so its square falls as lag^-4.
_MAX_LAG_SUPPORTS = 4


# A second difference has the weights (1, -2, 1) at (0, m, 2 m): the nine pairs of offsets of two second
# differences, and the products of their weights.
_WINDOW_OFFSETS = np.array([(p, q) for p in range(3) for q in range(3)])
_DIFFERENCE_WEIGHTS = np.outer((1.0, -2.0, 1.0), (1.0, -2.0, 1.0)).ravel()


def design_matrix(tau: Array) -> Array:
    """Return the (P, 5) Allan variances at tau (s) for unit Q^2, N^2, B^2, K^2, R^2 (IEEE 952-1997, C)."""
    return np.column_stack(
        [3.0 / tau**2, 1.0 / tau, np.full_like(tau, 2.0 * np.log(2.0) / np.pi), tau / 3.0, tau**2 / 2.0]
    )


def covariance_tensor(factors: NDArray[np.int64], samples: int, dt: float) -> Array:
    """Return the (P, P, 5, 5) tensor G with Cov(avar_i, avar_j) = sum_pq G[i, j, p, q] theta_p theta_q.

    theta holds the squares of Q, N, B, K, R. The Allan variance at averaging factor m is the mean of
    D_m(i)^2 / 2 over n_m = N - 2m + 1 positions i, where D_m, the difference of two adjacent window means,
    is Gaussian. Hence Cov = 1 / (2 n_a n_b) sum over lags of w(lag) c(lag)^2, where w is the number of
    pairs at that lag and c the cross-covariance of D_a and D_b. c follows from the generalised
    autocovariance of the integrated rate: Q^2 delta(t), -N^2 |t| / 2, B^2 t^2 ln|t| / (2 pi), K^2 |t|^3 /
    12 (Greenhall and Riley 2003; the same covariance as Vaccaro and Zaki 2012, for any mixture). A ramp
    shifts the mean of D_m by R tau.
    """
    count = len(factors)
    tensor = np.zeros((count, count, 5, 5))
    for i in range(count):
        for j in range(i, count):
            m_a, m_b = int(factors[i]), int(factors[j])
            tensor[i, j] = tensor[j, i] = _tensor_block(m_a, m_b, samples, dt)
    return tensor


def avar_covariance(tensor: Array, theta: Array) -> Array:
    """Return the (P, P) covariance of the Allan variances for theta, the squares of Q, N, B, K, R."""
    covariance: Array = np.einsum("ijpq,p,q->ij", tensor, theta, theta)
    return covariance


@lru_cache(maxsize=1 << 12)
def _tensor_block(m_a: int, m_b: int, samples: int, dt: float) -> Array:
    """Return the (5, 5) block of the tensor for factors m_a <= m_b.

    Cached, because all channels of a record and both fits need the same blocks.
    """
    n_a, n_b = samples - 2 * m_a + 1, samples - 2 * m_b + 1
    lags = _lags(m_a, m_b, n_a, n_b)
    # Each lag represents the interval between the midpoints to its two neighbours.
    edges = np.concatenate(([lags[0] - 0.5], (lags[1:] + lags[:-1]) / 2.0, [lags[-1] + 0.5]))
    weight = np.diff(edges) * _count_pairs(lags, n_a, n_b)
    smooth = _smooth_cross_covariance(lags, m_a, m_b, dt)
    spikes, heights = _quantisation_cross_covariance(m_a, m_b, dt)
    at_spikes = _smooth_cross_covariance(spikes, m_a, m_b, dt)
    spike_weight = _count_pairs(spikes, n_a, n_b)
    block = np.zeros((5, 5))
    block[1:4, 1:4] = (smooth * weight) @ smooth.T
    block[0, 0] = np.sum(spike_weight * heights**2)
    block[0, 1:4] = block[1:4, 0] = at_spikes @ (spike_weight * heights)
    block /= 2.0 * n_a * n_b
    # A deterministic mean mu of D adds mu_a mu_b c(lag) to the covariance of D^2 / 2.
    ramp = (
        np.concatenate(([np.sum(spike_weight * heights)], smooth @ weight))
        * (m_a * m_b * dt**2)
        / (n_a * n_b)
    )
    block[4, :4] = block[:4, 4] = ramp / 2.0
    return block


def _lags(m_a: int, m_b: int, n_a: int, n_b: int) -> NDArray[np.int64]:
    """Return the (L,) increasing lags at which the covariance is evaluated; for short windows, every lag."""
    low, high = (
        max(1 - n_a, m_a - m_b - _MAX_LAG_SUPPORTS * (m_a + m_b)),
        min(n_b - 1, m_a - m_b + _MAX_LAG_SUPPORTS * (m_a + m_b)),
    )
    between = np.linspace(low, high, 16 * _LAGS_PER_WINDOW + 1)
    near = np.linspace(
        -_KINK_REACH_WINDOWS * m_a, _KINK_REACH_WINDOWS * m_a, 2 * _KINK_REACH_WINDOWS * _LAGS_PER_WINDOW + 1
    )
    kinks = _WINDOW_OFFSETS @ (m_a, -m_b)
    lags = np.unique(np.rint(np.concatenate((between, (kinks[:, None] + near).ravel()))).astype(np.int64))
    return lags[(lags >= low) & (lags <= high)]


def _count_pairs(lags: NDArray[np.int64], n_a: int, n_b: int) -> Array:
    """Return the number of pairs (i, j), 0 <= i < n_a, 0 <= j < n_b, with j - i = lag, for each lag."""
    count: Array = np.clip(np.minimum(min(n_a, n_b), np.minimum(n_a + lags, n_b - lags)), 0, None).astype(
        float
    )
    return count


def _smooth_cross_covariance(lags: NDArray[np.int64], m_a: int, m_b: int, dt: float) -> Array:
    """Return the (3, L) cross-covariance of D_a and D_b for unit N^2, B^2, K^2."""
    t = np.abs(lags + (_WINDOW_OFFSETS @ (-m_a, m_b))[:, None]) / m_b
    logarithm = np.log(t, out=np.zeros_like(t), where=t > 0)
    square = t * t
    total = np.stack(
        [
            _DIFFERENCE_WEIGHTS @ t / -2.0,
            _DIFFERENCE_WEIGHTS @ (square * logarithm) / (2.0 * np.pi),
            _DIFFERENCE_WEIGHTS @ (square * t) / 12.0,
        ]
    )
    scale = m_b * dt
    covariance: Array = total * np.array([[scale], [scale**2], [scale**3]]) / (m_a * m_b * dt**2)
    return covariance


def _quantisation_cross_covariance(m_a: int, m_b: int, dt: float) -> tuple[NDArray[np.int64], Array]:
    """Return the lags at which quantisation noise correlates D_a and D_b, and the covariance for unit Q^2."""
    covariance_at: dict[int, float] = {}
    for p, alpha in enumerate((1.0, -2.0, 1.0)):
        for q, beta in enumerate((1.0, -2.0, 1.0)):
            lag = p * m_a - q * m_b
            covariance_at[lag] = covariance_at.get(lag, 0.0) + alpha * beta
    return np.array(list(covariance_at), np.int64), np.array(list(covariance_at.values())) / (
        m_a * m_b * dt**2
    )
