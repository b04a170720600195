"""Detection probability over the logarithm of size: a probit curve, and the next sizes to try."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

from gap_matrix.world import Array

# Of ln size: where a stage that knows nothing looks, and what is thought of the curve beforehand. A test of
# known power rises from 16 to 84 % within 0.5 at this false alarm, and nothing can be much steeper.
FIRST_LOOK = (-0.1, 0.15, 0.4, 0.65, 0.9, 1.2)
_MIDDLE, _MIDDLE_SIGMA = 0.4, 0.8
_WIDTH, _WIDTH_SIGMA = np.log(0.25), 0.5
_MIDDLES, _WIDTHS = np.linspace(-1.5, 3.5, 201), np.exp(np.linspace(np.log(0.05), np.log(2.0), 60))
_LOOKS = (-1.2, -0.5, 0.0, 0.4, 0.9, 1.5)


@dataclass(frozen=True)
class Curve:
    """A probit curve: detection probability Φ((x - middle) / width) at ln size x.

    weight: (M, W) how likely each middle and width of the grid is.
    """

    middle: float
    width: float
    weight: Array

    def seen(self, x: Array) -> Array:
        return np.asarray(norm.cdf((x - self.middle) / self.width))

    def spread(self, share: float) -> float:
        """1 sigma of the ln size that is seen with chance `share`."""
        at = _MIDDLES[:, None] + norm.ppf(share) * _WIDTHS
        mean = float(np.sum(self.weight * at))
        return float(np.sqrt(np.sum(self.weight * (at - mean) ** 2)))


def fitted(x: Sequence[float], seen: Sequence[bool]) -> Curve:
    """Return the posterior mean of all curves, given trials and prior."""
    z = (np.asarray(x)[:, None, None] - _MIDDLES[:, None]) / _WIDTHS
    hit = np.asarray(seen, bool)[:, None, None]
    logs = np.where(hit, norm.logcdf(z), norm.logsf(z)).sum(axis=0)
    logs -= 0.5 * ((_MIDDLES[:, None] - _MIDDLE) / _MIDDLE_SIGMA) ** 2
    logs = logs - 0.5 * ((np.log(_WIDTHS) - _WIDTH) / _WIDTH_SIGMA) ** 2
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    middle = float(np.sum(weight * _MIDDLES[:, None]))
    return Curve(middle, float(np.exp(np.sum(weight * np.log(_WIDTHS)))), weight)


def next_look(x: Sequence[float], seen: Sequence[bool], count: int) -> list[float]:
    """Return the `count` most informative ln sizes for further trials, in an unbiased order."""
    if not len(x):
        asked = np.interp(np.linspace(0, 5, count), range(6), FIRST_LOOK)
    else:
        curve = fitted(x, seen)
        asked = curve.middle + curve.width * np.interp(np.linspace(0, 5, count), range(6), _LOOKS)
    return [float(asked[k]) for k in np.random.default_rng(count + len(x)).permutation(count)]


def size_seen(share: Callable[[float], float], wanted: float) -> float:
    """Return the size at which `share`, which increases with size, equals `wanted`."""
    return float(np.exp(brentq(lambda x: share(float(np.exp(x))) - wanted, np.log(1e-6), np.log(1e6))))
