"""Covariance of overlapping Allan variances, for any mixture of the five noise terms of IEEE 952."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

TERMS = ("Q", "N", "B", "K", "R")
"""Quantisation, angle random walk, bias instability, rate random walk, rate ramp (IEEE 952)."""

# The covariance is a sum over lags, smooth but for kinks where edges of two windows meet: this many steps per
# shorter window around the kinks, and per longer window in between.
_STEPS = 12
_KINK_REACH = 3
# White noise and random walk end at one support; flicker noise falls off as lag^-2, so its square as lag^-4.
_SUPPORTS = 4


# A second difference is (1, -2, 1) at (0, m, 2 m): all nine pairs of its parts, and their weights.
_OFFSETS = np.array([(p, q) for p in range(3) for q in range(3)])
_WEIGHTS = np.outer((1.0, -2.0, 1.0), (1.0, -2.0, 1.0)).ravel()


def design(tau: FloatArray) -> FloatArray:
    """(P, 5) Allan variance of unit Q^2, N^2, B^2, K^2, R^2 at tau (s); IEEE 952-1997, annex C."""
    return np.column_stack(
        [3.0 / tau**2, 1.0 / tau, np.full_like(tau, 2.0 * np.log(2.0) / np.pi), tau / 3.0, tau**2 / 2.0]
    )


def covariance_tensor(factors: NDArray[np.int64], samples: int, dt: float) -> FloatArray:
    """(P, P, 5, 5) tensor G with Cov(avar_i, avar_j) = sum_pq G[i, j, p, q] theta_p theta_q.

    theta: squares of Q, N, B, K, R. The estimate at factor m is the mean of D_m(i)^2 / 2 over n_m = N - 2m +
    1 positions, D_m Gaussian, so Cov = 1 / (2 n_a n_b) sum over lags of w(lag) c(lag)^2, with w the number of
    pairs at that lag and c the cross-covariance of D_a and D_b; c follows from the generalised autocovariance
    of the integrated rate: Q^2 delta(t), -N^2 |t| / 2, B^2 t^2 ln|t| / (2 pi), K^2 |t|^3 / 12 (Greenhall and
    Riley 2003; the same covariance as Vaccaro and Zaki 2012, for any mixture). A ramp shifts the mean of D_m
    by R tau.
    """
    count = len(factors)
    tensor = np.zeros((count, count, 5, 5))
    for i in range(count):
        for j in range(i, count):
            a, b = int(factors[i]), int(factors[j])
            tensor[i, j] = tensor[j, i] = _pair(a, b, samples, dt)
    return tensor


def point_covariance(tensor: FloatArray, theta: FloatArray) -> FloatArray:
    """(P, P) covariance of the Allan variances for theta, the squares of Q, N, B, K, R."""
    made: FloatArray = np.einsum("ijpq,p,q->ij", tensor, theta, theta)
    return made


@lru_cache(maxsize=1 << 12)
def _pair(a: int, b: int, samples: int, dt: float) -> FloatArray:
    """(5, 5) of the tensor for factors a <= b; kept, as the channels of a record and both fits ask for it."""
    n_a, n_b = samples - 2 * a + 1, samples - 2 * b + 1
    lags = _lags(a, b, n_a, n_b)
    # Each lag stands for the stretch halfway to its neighbours.
    edges = np.concatenate(([lags[0] - 0.5], (lags[1:] + lags[:-1]) / 2.0, [lags[-1] + 0.5]))
    weight = np.diff(edges) * _pairs_at(lags, n_a, n_b)
    smooth = _smooth(lags, a, b, dt)
    spikes, heights = _spikes(a, b, dt)
    at_spikes = _smooth(spikes, a, b, dt)
    spike_weight = _pairs_at(spikes, n_a, n_b)
    made = np.zeros((5, 5))
    made[1:4, 1:4] = (smooth * weight) @ smooth.T
    made[0, 0] = np.sum(spike_weight * heights**2)
    made[0, 1:4] = made[1:4, 0] = at_spikes @ (spike_weight * heights)
    made /= 2.0 * n_a * n_b
    # A deterministic shift mu of D adds mu_a mu_b c(lag) to the covariance of D^2 / 2.
    ramp = np.concatenate(([np.sum(spike_weight * heights)], smooth @ weight)) * (a * b * dt**2) / (n_a * n_b)
    made[4, :4] = made[:4, 4] = ramp / 2.0
    return made


def _lags(a: int, b: int, n_a: int, n_b: int) -> NDArray[np.int64]:
    """(L,) increasing lags at which the covariance is taken: all of them for short windows."""
    low, high = max(1 - n_a, a - b - _SUPPORTS * (a + b)), min(n_b - 1, a - b + _SUPPORTS * (a + b))
    between = np.linspace(low, high, 16 * _STEPS + 1)
    near = np.linspace(-_KINK_REACH * a, _KINK_REACH * a, 2 * _KINK_REACH * _STEPS + 1)
    kinks = _OFFSETS @ (a, -b)
    lags = np.unique(np.rint(np.concatenate((between, (kinks[:, None] + near).ravel()))).astype(np.int64))
    return lags[(lags >= low) & (lags <= high)]


def _pairs_at(lags: NDArray[np.int64], n_a: int, n_b: int) -> FloatArray:
    """How many (i, j), 0 <= i < n_a, 0 <= j < n_b, have j - i = lag."""
    number: FloatArray = np.clip(
        np.minimum(min(n_a, n_b), np.minimum(n_a + lags, n_b - lags)), 0, None
    ).astype(float)
    return number


def _smooth(lags: NDArray[np.int64], a: int, b: int, dt: float) -> FloatArray:
    """(3, L) cross-covariance of D_a and D_b for unit N^2, B^2, K^2."""
    t = np.abs(lags + (_OFFSETS @ (-a, b))[:, None]) / b
    logarithm = np.log(t, out=np.zeros_like(t), where=t > 0)
    square = t * t
    total = np.stack(
        [_WEIGHTS @ t / -2.0, _WEIGHTS @ (square * logarithm) / (2.0 * np.pi), _WEIGHTS @ (square * t) / 12.0]
    )
    scale = b * dt
    made: FloatArray = total * np.array([[scale], [scale**2], [scale**3]]) / (a * b * dt**2)
    return made


def _spikes(a: int, b: int, dt: float) -> tuple[NDArray[np.int64], FloatArray]:
    """Lags at which quantisation noise correlates D_a with D_b, and its covariance there for unit Q^2."""
    found: dict[int, float] = {}
    for p, alpha in enumerate((1.0, -2.0, 1.0)):
        for q, beta in enumerate((1.0, -2.0, 1.0)):
            lag = p * a - q * b
            found[lag] = found.get(lag, 0.0) + alpha * beta
    return np.array(list(found), np.int64), np.array(list(found.values())) / (a * b * dt**2)
