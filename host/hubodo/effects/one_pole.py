"""A low-pass of one pole on samples at uneven times."""

import numpy as np

from hubodo.arrays import Array


def one_pole(t: Array, value: Array, slope: Array, time_constant: float) -> Array:
    """What a low-pass of time_constant s makes of a signal.

    value, slope: (k, N) at t, (N,) s. y' = (x - y) / T, solved exactly for the cubic through values and
    slopes of each step; before the first sample the signal is taken as constant.
    Raises ValueError for a time constant that is not positive.
    """
    if not time_constant > 0.0:
        raise ValueError(f"time constant {time_constant} s: must be above 0")
    step = np.diff(t)
    forced, decay = _steps(step / time_constant, step, value, slope)
    # y[i+1] = decay[i] y[i] + forced[i]: combined over 1, 2, 4, ... steps until nothing is left of the past.
    lag = np.concatenate([value[:, :1], forced], axis=1)
    keep = np.concatenate([[0.0], decay])
    reach = 1
    while reach < len(t) and keep.max() > 1e-13:
        lag[:, reach:] += keep[reach:] * lag[:, :-reach].copy()
        keep[reach:] = keep[reach:] * keep[:-reach].copy()
        keep[:reach] = 0.0
        reach *= 2
    return lag


def _steps(h: Array, step: Array, value: Array, slope: Array) -> tuple[Array, Array]:
    """Response of each step to its cubic input, (k, N-1), and the decay over it, (N-1,); h: steps / T."""
    x0, x1 = value[:, :-1], value[:, 1:]
    d0, d1 = slope[:, :-1] * step, slope[:, 1:] * step
    a1, a2, a3 = d0, 3.0 * (x1 - x0) - 2.0 * d0 - d1, 2.0 * (x0 - x1) + d0 + d1
    decay = np.exp(-h)
    # m_n = ∫₀¹ h e^(-h (1 - s)) sⁿ ds; by parts m_n = 1 - n m_(n-1) / h.
    # By series where h is so small that the recursion cancels.
    small = h < 0.3
    big = np.where(small, 1.0, h)
    moments = [-np.expm1(-h)]
    for n in (1, 2, 3):
        series, term = np.zeros_like(h), h / (n + 1.0)
        for k in range(1, 12):
            series = series + term
            term = term * -h / (n + k + 1.0)
        moments.append(np.where(small, series, 1.0 - n * moments[-1] / big))
    forced = x0 * moments[0] + a1 * moments[1] + a2 * moments[2] + a3 * moments[3]
    return forced, decay
