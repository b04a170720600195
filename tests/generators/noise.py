"""Rate noise of known Q, N, B, K, R, made without any code of hubodo.

Flicker noise by the fractional difference of Kasdin (Proc. IEEE 83(5), 1995, eq. 104..): white noise of
variance B^2 through h_0 = 1, h_k = h_{k-1} (k - 1/2) / k has the one-sided density B^2 / (pi f) of IEEE 952's
bias instability, at any sample rate. The others straight from their definition: quantisation is the
difference quotient of an angle with white error Q, angle random walk a white rate of density N, rate random
walk the sum of white steps K sqrt(dt), ramp R t.
"""

import numpy as np
from scipy.signal import fftconvolve


def gyro_noise(samples, dt, rng, *, q=0.0, n=0.0, b=0.0, k=0.0, r=0.0):
    """(samples,) rates in the unit of the coefficients, from rng."""
    made = np.zeros(samples)
    if q:
        made += np.diff(rng.normal(0.0, q, samples + 1)) / dt
    if n:
        made += rng.normal(0.0, n / np.sqrt(dt), samples)
    if b:
        steps = np.arange(1, samples)
        response = np.concatenate(([1.0], np.cumprod((steps - 0.5) / steps)))
        made += fftconvolve(rng.normal(0.0, b, samples), response)[:samples]
    if k:
        made += np.cumsum(rng.normal(0.0, k * np.sqrt(dt), samples))
    if r:
        made += r * dt * np.arange(samples)
    return made
