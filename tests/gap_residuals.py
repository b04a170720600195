"""Synthetic readings and residuals of one node for the tests of `hubodo gap`."""

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.state.noise import ChannelNoise
from hubodo.vehicle import NodeMount

SEEDS = (1, 2)
RATE_HZ, SIGMA = 49.3, np.repeat([0.01, 0.2], 3)[:, None]  # rad/s and m/s²
WINDOW = 0.5  # s


def build_residual(y, predicted, *, name="left", limits=(np.inf, np.inf), is_new=None, effects=()):
    """Return the residual of a node with readings y (6, N), predicted readings (6, N) and noise SIGMA."""
    count = y.shape[1]
    is_new = np.ones(count, bool) if is_new is None else is_new
    t = 0.003 + np.arange(count) / RATE_HZ
    node = NodeData(name, NodeMount("left", "left"), t, y, np.ones(6, bool), limits, None)
    noise, zero = ChannelNoise(SIGMA, np.zeros(count, np.uint8), is_new), np.zeros_like(y)
    present = {BY_NAME[effect]: None for effect in effects}
    return Residual(node, y - predicted, SIGMA, noise, zero, np.zeros(6), present)


def draw_readings(rng, count=1500):
    """Return readings of a turning wheel (6, N), 30 s by default, without and with white noise SIGMA."""
    t = np.arange(count) / RATE_HZ
    waves = [0.2 * np.cos(5.0 * t), 0.2 * np.sin(5.0 * t), 5.0 + np.sin(0.3 * t)]
    waves += [9.8 * np.cos(5.0 * t), -9.8 * np.sin(5.0 * t), 0.3 * np.sin(0.3 * t)]
    clean = np.stack(waves)
    return clean, clean + SIGMA * rng.standard_normal(clean.shape)


def draw_readings_with_walk(rng, k, count=3000):
    """Return readings without noise, and with white noise and a gyro random walk of k rad/s/√s."""
    clean, y = draw_readings(rng, count)
    y[:3] += np.cumsum(k / np.sqrt(RATE_HZ) * rng.standard_normal((3, count)), axis=1)
    return clean, y


def draw_readings_with_repeats(rng, probability, step):
    """Return readings without noise, quantized readings with repeated samples, and a mask of new ones."""
    clean, y = draw_readings(rng)
    y = step * np.round(y / step)
    is_repeated = rng.random(y.shape[1]) < probability
    is_repeated[0] = False
    for index in np.flatnonzero(is_repeated):
        y[:, index] = y[:, index - 1]
    is_new = np.concatenate([[True], (np.diff(y, axis=1) != 0.0).any(axis=0)])
    return clean, y, is_new


def find_by_scope(proposals, scope):
    """Return the first proposal with this scope."""
    return next(it for it in proposals if it.term.scope == scope)
