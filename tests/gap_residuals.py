"""Synthetic residuals of one node for the tests of the scatter detectors."""

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.state.noise import ChannelNoise
from hubodo.vehicle import NodeMount

SEEDS = (1, 2)
RATE_HZ, SIGMA = 49.3, np.repeat([0.01, 0.2], 3)[:, None]  # rad/s and m/s²
WINDOW = 0.5  # s


def shown(y, predicted, *, name="left", limits=(np.inf, np.inf), fresh=None, effects=()):
    """What a node with readings y, (6, N), shows beside what was predicted, with noise SIGMA."""
    count = y.shape[1]
    fresh = np.ones(count, bool) if fresh is None else fresh
    t = 0.003 + np.arange(count) / RATE_HZ
    node = NodeData(name, NodeMount("left", "left"), t, y, np.ones(6, bool), limits, None)
    noise, zero = ChannelNoise(SIGMA, np.zeros(count, np.uint8), fresh), np.zeros_like(y)
    present = {BY_NAME[effect]: None for effect in effects}
    return Residual(node, y - predicted, SIGMA, noise, zero, np.zeros(6), present)


def white(rng, count=1500):
    """Wheel-like readings of 30 s, and the same with white noise."""
    t = np.arange(count) / RATE_HZ
    waves = [0.2 * np.cos(5.0 * t), 0.2 * np.sin(5.0 * t), 5.0 + np.sin(0.3 * t)]
    waves += [9.8 * np.cos(5.0 * t), -9.8 * np.sin(5.0 * t), 0.3 * np.sin(0.3 * t)]
    clean = np.stack(waves)
    return clean, clean + SIGMA * rng.standard_normal(clean.shape)


def walking(rng, k, count=3000):
    clean, y = white(rng, count)
    y[:3] += np.cumsum(k / np.sqrt(RATE_HZ) * rng.standard_normal((3, count)), axis=1)
    return clean, y


def repeated(rng, probability, step):
    """(clean, y, fresh): readings on a lattice, and some samples sent again."""
    clean, y = white(rng)
    y = step * np.round(y / step)
    late = rng.random(y.shape[1]) < probability
    late[0] = False
    for at in np.flatnonzero(late):
        y[:, at] = y[:, at - 1]
    fresh = np.concatenate([[True], (np.diff(y, axis=1) != 0.0).any(axis=0)])
    return clean, y, fresh


def only(proposals, scope):
    return next(it for it in proposals if it.term.scope == scope)
