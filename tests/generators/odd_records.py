"""Disturbances of a gyro record by name, as on benches: steps, ramps, kicks, gaps, rounding, vibration.

An additive disturbance is a function of (t, rng, size) and returns rates (N,), rad/s, so that the truth can
contain it; a change is a function of (t, gyro, accel, rng, size) and returns the three arrays. size: rad/s,
the scale of the estimated quantity. None shares code with the estimators.
"""

import numpy as np
from scipy.signal import lfilter


def bias_step(t, rng, size):
    """Return a step at a random time in the middle."""
    return rng.choice([-1, 1]) * 3 * size * (t > t[0] + _length(t) * rng.uniform(0.25, 0.6))


def ramp_and_return(t, rng, size):
    """Return the effect of a temperature that rises, stays and falls, with a lag of a twentieth."""
    share = (t - t[0]) / _length(t)
    start, rise = rng.uniform(0.1, 0.3), rng.uniform(0.1, 0.3)
    knots = [0, start, start + rise, start + rise + 0.1, start + 2 * rise + 0.1]
    shape = np.interp(share, knots, [0, 0, 1, 1, 0])
    pole = np.exp(-20 * np.median(np.diff(share)))
    return 3 * size * rng.choice([-1, 1]) * lfilter([1 - pole], [1, -pole], shape)


def random_walk(t, rng, size):
    """Return a random walk that reaches 2 sizes at the end (1 sigma)."""
    steps = np.sqrt(np.diff(t, prepend=t[0])) * rng.standard_normal(len(t))
    return 2 * size * np.cumsum(steps) / np.sqrt(_length(t))


def correlated(t, rng, size):
    """Return Gauss-Markov noise of one size with a correlation time of 5 s."""
    pole = np.exp(-np.median(np.diff(t)) / 5.0)
    return size * lfilter([np.sqrt(1 - pole * pole)], [1, -pole], rng.standard_normal(len(t)))


def sway(t, rng, size):
    """Return a slow line, of a building or a mast: 0.07 Hz."""
    return 2 * size * np.sin(2 * np.pi * 0.07 * t + rng.uniform(0, 2 * np.pi))


def vibration(t, rng, size):
    """Return two lines of a machine."""
    return 50 * size * (np.sin(2 * np.pi * 11.3 * t) + 0.6 * np.sin(2 * np.pi * 17.9 * t + rng.uniform(0, 6)))


def daily_cycle(t, rng, size):
    """Return the bias of a room whose temperature goes through 0.7 of a cycle."""
    return 3 * size * np.sin(2 * np.pi * (t - t[0]) / (0.7 * _length(t)) + rng.uniform(0, 2 * np.pi))


ADDED = {
    "bias step": bias_step,
    "ramp up and down": ramp_and_return,
    "bias walks": random_walk,
    "noise over 5 s": correlated,
    "sway at 0.07 Hz": sway,
    "vibration lines": vibration,
    "daily cycle": daily_cycle,
}


def half_rate(t, gyro, accel, rng, size):
    """Average pairs of samples in the second half, as a chip does that changes its data rate."""
    middle = len(t) // 2
    count = (len(t) - middle) // 2

    def halved(values):
        pairs = values[middle : middle + 2 * count].reshape(count, 2, *values.shape[1:]).mean(axis=1)
        return np.concatenate([values[:middle], pairs])

    return halved(t), halved(gyro), halved(accel)


def gaps(t, gyro, accel, rng, size):
    """Drop six spans of up to 3 % of the record."""
    present = np.ones(len(t), bool)
    for start in rng.uniform(0.02, 0.95, 6):
        start = t[0] + start * _length(t)
        present &= ~((t > start) & (t < start + rng.uniform(0.001, 0.03) * _length(t)))
    return t[present], gyro[present], accel[present]


def coarse(t, gyro, accel, rng, size):
    """Round to steps of four times the noise."""
    step = 4 * np.median(np.abs(np.diff(gyro, axis=0))) / 0.6745 / np.sqrt(2)
    return t, step * np.rint(gyro / step), accel


def very_coarse(t, gyro, accel, rng, size):
    """Round to steps of fifteen times the noise: hardly any sample differs from its neighbour."""
    step = 15 * np.median(np.abs(np.diff(gyro, axis=0))) / 0.6745 / np.sqrt(2)
    return t, step * np.rint(gyro / step), accel


def kicks(t, gyro, accel, rng, size):
    """Add three blows of 0.3 s and 2 deg/s, in one direction."""
    gyro = gyro.copy()
    for start in rng.uniform(0.05, 0.95, 3):
        rows = slice(*np.searchsorted(t, t[0] + start * _length(t) + np.array([0, 0.3])))
        gyro[rows] += np.radians(2)
    return t, gyro, accel


def clipped(t, gyro, accel, rng, size):
    """Clip each axis at half a sigma above its median."""
    noise = np.median(np.abs(np.diff(gyro, axis=0)), axis=0) / 0.6745 / np.sqrt(2)
    return t, np.minimum(gyro, np.median(gyro, axis=0) + 0.5 * noise), accel


def reversed_axes(t, gyro, accel, rng, size):
    """Reverse x and z of the gyro, as a wrong mounting table does; the accelerometer is right."""
    return t, gyro * [-1, 1, -1], accel


def missing_rows(t, gyro, accel, rng, size):
    """Replace 2 % of the rows by NaN."""
    gyro = gyro.copy()
    gyro[rng.random(len(t)) < 0.02] = np.nan
    return t, gyro, accel


def moving(t, gyro, accel, rng, size):
    """Turn the node slowly to and fro by hand during a tenth of the record, with gravity."""
    start = t[0] + rng.uniform(0.1, 0.7) * _length(t)
    inside = (t > start) & (t < start + 0.1 * _length(t))
    phase = 2 * np.pi * (t - start) / 7.0
    angle = np.where(inside, 0.05 * (1 - np.cos(phase)), 0.0)
    gyro = gyro + np.where(inside, 0.05 * 2 * np.pi / 7.0 * np.sin(phase), 0.0)[:, None] * [0.6, 0.8, 0.3]
    return t, gyro, accel + 9.8 * np.sin(angle)[:, None] * [-0.8, 0.6, 0.0]


def short(t, gyro, accel, rng, size):
    """Keep the first fifteenth."""
    rows = slice(len(t) // 15)
    return t[rows], gyro[rows], accel[rows]


def missing_codes(t, gyro, accel, rng, size):
    """Convert with codes as wide as the noise, whose edges are off by 0.4 of a code; a tenth are missing."""
    step = np.median(np.abs(np.diff(gyro, axis=0))) / 0.6745 / np.sqrt(2)
    first = np.floor(gyro.min() / step) - 2
    codes = first + np.arange(np.ceil(gyro.max() / step) - first + 3.0)
    edges = np.sort(codes - 0.5 + 0.4 * rng.standard_normal(len(codes)).clip(-1, 1))
    used = rng.random(len(codes)) > 0.1
    # The width of a missing code is shared by its neighbours, so that the mean over all codes has no bias.
    middle = (edges + np.append(edges[1:], edges[-1] + 1)) / 2
    edges[1:] = np.where(used[:-1], edges[1:], middle[:-1])
    edges = np.where(used, edges, middle)[used]
    index = np.clip(np.searchsorted(edges, gyro / step) - 1, 0, len(edges) - 1)
    return t, step * codes[used][index], accel


def low_pass(t, gyro, accel, rng, size):
    """Filter both sensors by one pole at 5 Hz."""
    pole = np.exp(-2 * np.pi * 5.0 * np.median(np.diff(t)))

    def filtered(values):
        return lfilter([1 - pole], [1, -pole], values - values[0], axis=0) + values[0]

    return t, filtered(gyro), filtered(accel)


def other_unit(t, gyro, accel, rng, size):
    """Continue with the samples of another unit in the second half: its bias and three times the noise."""
    gyro, half = gyro.copy(), len(t) // 2
    noise = np.median(np.abs(np.diff(gyro, axis=0)), axis=0) / 0.6745 / np.sqrt(2)
    gyro[half:] += 20 * size * rng.choice([-1, 1], 3)
    gyro[half:] += np.sqrt(8.0) * noise * rng.standard_normal((len(t) - half, 3))
    return t, gyro, accel


FAST_CLOCK = 1.01


def fast_clock(t, gyro, accel, rng, size):
    """Stamp the samples by a clock that runs one per cent fast."""
    return t[0] + FAST_CLOCK * (t - t[0]), gyro, accel


CHANGES = {
    "half the rate": half_rate,
    "six gaps": gaps,
    "LSB of 4 sigma": coarse,
    "LSB of 15 sigma": very_coarse,
    "three kicks": kicks,
    "clipped": clipped,
    "axes reversed": reversed_axes,
    "rows of NaN": missing_rows,
    "moved by hand": moving,
    "too short": short,
    "missing codes": missing_codes,
    "low-pass at 5 Hz": low_pass,
    "half of another unit": other_unit,
    "clock 1 % fast": fast_clock,
}


def disturb(name, t, gyro, accel, rng, size):
    """Return t, gyro and accel with the disturbance `name`; "none" returns them as they are."""
    if name in ADDED:
        gyro = gyro + np.stack([ADDED[name](t, rng, size) for _ in range(3)], axis=1)
    if name in CHANGES:
        return CHANGES[name](t, gyro, accel, rng, size)
    return t, gyro, accel


def _length(t):
    return t[-1] - t[0]
