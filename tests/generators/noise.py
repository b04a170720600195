"""Rate noise of known Q, N, B, K, R, filtered as by electronics, without any code of hubodo.

Flicker noise is the fractional difference of Kasdin (Proc. IEEE 83(5), 1995, eq. 104): white noise of
variance B^2 through h_0 = 1, h_k = h_{k-1} (k - 1/2) / k has the one-sided density B^2 / (pi f) of IEEE 952's
bias instability, at any sample rate. `relaxing` approximates it by a sum of relaxations, as in
semiconductors. The others follow their definitions: quantisation is the difference quotient of an angle with
white error Q, angle random walk a white rate of density N, rate random walk the sum of white steps K
sqrt(dt), ramp R t.
"""

import numpy as np
from scipy.signal import butter, fftconvolve, lfilter, sosfilt


def gyro_noise(samples, dt, rng, *, q=0.0, n=0.0, b=0.0, k=0.0, r=0.0):
    """Return simulated rates, (samples,), in the units of the coefficients."""
    noise = np.zeros(samples)
    if q:
        noise += np.diff(rng.normal(0.0, q, samples + 1)) / dt
    if n:
        noise += rng.normal(0.0, n / np.sqrt(dt), samples)
    if b:
        steps = np.arange(1, samples)
        response = np.concatenate(([1.0], np.cumprod((steps - 0.5) / steps)))
        noise += fftconvolve(rng.normal(0.0, b, samples), response)[:samples]
    if k:
        noise += np.cumsum(rng.normal(0.0, k * np.sqrt(dt), samples))
    if r:
        noise += r * dt * np.arange(samples)
    return noise


def relaxing(samples, dt, rng, b, *, per_decade=3):
    """Return flicker noise (samples,) of bias instability b as relaxations from dt to beyond the record.

    Relaxations of equal variance v whose time constants are spaced evenly by a factor e^h add up to a
    one-sided density v / (h f) (McWhorter 1957): v = h b^2 / pi.
    """
    step = np.log(10.0) / per_decade
    constants = np.exp(np.arange(np.log(dt / 3.0), np.log(30.0 * samples * dt), step))
    noise = np.zeros(samples)
    sigma = b * np.sqrt(step / np.pi)
    for constant in constants:
        keep = np.exp(-dt / constant)
        drive = rng.normal(0.0, sigma * np.sqrt(-np.expm1(-2.0 * dt / constant)), samples)
        drive[0] = rng.normal(0.0, sigma)
        noise += lfilter([1.0], [1.0, -keep], drive)
    return noise


def one_pole(rates, dt, corner):
    """Filter rates by a one-pole low-pass at corner (Hz), DC gain 1."""
    keep = np.exp(-2.0 * np.pi * corner * dt)
    return lfilter([1.0 - keep], [1.0, -keep], rates - rates[0]) + rates[0]


def two_pole(rates, dt, corner):
    """Filter rates by a second-order Butterworth low-pass, the second filter of many chips."""
    return sosfilt(butter(2, 2.0 * corner * dt, output="sos"), rates - rates[0]) + rates[0]


def bartlett(rates, taps):
    """Filter rates by a triangular window of 2 taps - 1 samples, as offered by the ADIS16405."""
    window = np.convolve(np.ones(taps), np.ones(taps)) / taps**2
    return fftconvolve(rates - rates[0], window)[: len(rates)] + rates[0]
