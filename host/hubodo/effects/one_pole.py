"""First-order low-pass filter for unevenly spaced samples."""

import numpy as np

from hubodo.arrays import Array


def one_pole(t: Array, value: Array, slope: Array, time_constant: float) -> Array:
    """Return the response of a first-order low-pass filter to a signal, (k, N).

    Solves y' = (x - y) / T, with input x, output y and time constant T, exactly for the cubic Hermite
    interpolation of x. The signal is constant before the first sample.

    Parameters
    ----------
    t : (N,) s, increasing.
    value, slope : (k, N) the input and its derivative at t.
    time_constant : s.

    Raises
    ------
    ValueError
        If the time constant is not positive.
    """
    if not time_constant > 0.0:
        raise ValueError(f"time constant {time_constant} s: must be above 0")
    step = np.diff(t)
    forced, decay = _step_responses(step / time_constant, step, value, slope)
    # y[i+1] = decay[i] y[i] + forced[i], combined over 1, 2, 4, ... steps until the memory has decayed.
    output = np.concatenate([value[:, :1], forced], axis=1)
    memory = np.concatenate([[0.0], decay])
    span = 1
    while span < len(t) and memory.max() > 1e-13:
        output[:, span:] += memory[span:] * output[:, :-span].copy()
        memory[span:] = memory[span:] * memory[:-span].copy()
        memory[:span] = 0.0
        span *= 2
    return output


def _step_responses(h: Array, step: Array, value: Array, slope: Array) -> tuple[Array, Array]:
    """Return the response to the cubic input of each step, (k, N-1), and the decay over it, (N-1,).

    h: (N-1,) steps divided by the time constant. step: (N-1,) s.
    """
    x0, x1 = value[:, :-1], value[:, 1:]
    d0, d1 = slope[:, :-1] * step, slope[:, 1:] * step
    a1, a2, a3 = d0, 3.0 * (x1 - x0) - 2.0 * d0 - d1, 2.0 * (x0 - x1) + d0 + d1
    decay = np.exp(-h)
    # Moments m_n = ∫₀¹ h e^(-h (1 - s)) sⁿ ds. Integration by parts gives m_n = 1 - n m_(n-1) / h; a series
    # replaces this recursion where h is so small that its terms cancel.
    use_series = h < 0.3
    divisor = np.where(use_series, 1.0, h)
    moments = [-np.expm1(-h)]
    for n in (1, 2, 3):
        series, term = np.zeros_like(h), h / (n + 1.0)
        for k in range(1, 12):
            series = series + term
            term = term * -h / (n + k + 1.0)
        moments.append(np.where(use_series, series, 1.0 - n * moments[-1] / divisor))
    forced = x0 * moments[0] + a1 * moments[1] + a2 * moments[2] + a3 * moments[3]
    return forced, decay
