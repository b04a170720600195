"""Detection of a gyro that fails during a drive: gravity no longer rotates with its rate about the axle.

A gyro that sticks, or a chip that returns to another range after a loss of power, goes on with wrong rates.
The accelerometers show it: with the rate integrated to an angle, gravity derotated by that angle is constant.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.recording import Table

_ROTATION_BLOCK_S = 3.0
"""s in which a wheel at walking pace turns several times."""
_MIN_ROTATION_SAMPLES = 30
"""Samples of a block; ten a second are fewer than the filter accepts."""
_MIN_ROTATING_FORCE, _MAX_ROTATING_FORCE = 0.7 * STANDARD_GRAVITY, 2.0 * STANDARD_GRAVITY
"""m/s², rms of the force across the axle about its mean, in a block in which gravity rotates."""
_VALID_SHARE, _FAILED_SHARE = 0.85, 0.3
"""Derotated force over its rms, above which a gyro is valid, and below which it has failed. Bumps of half of
gravity leave 0.9 of a valid one; an angle that is wrong by 9 rad at the end of a block leaves 0.2."""
_MIN_VALID_BLOCKS, _MIN_FAILED_BLOCKS, _MIN_REPAIRED_BLOCKS = 3, 4, 10
"""Blocks with rotating gravity that show a valid gyro, a failed one, and a valid one again: a gyro that
sticks fits a wheel that rolls at that rate for a while."""


def find_gyro_failure(table: Table) -> NDArray[np.bool_]:
    """Return a mask (N,) of the samples of a node after its gyro failed, until it is valid again.

    A node whose gyro was never valid, as one with exchanged axes, is left to other checks.
    """
    mask = np.zeros(len(table), np.bool_)
    edges, shares = _derotated_shares(table)
    rotating = np.flatnonzero(np.isfinite(shares))
    is_valid, failed = shares[rotating] > _VALID_SHARE, np.flatnonzero(shares[rotating] < _FAILED_SHARE)
    n_valid_between = [np.count_nonzero(is_valid[first:end]) for first, end in pairwise(failed.tolist())]
    for group in np.split(failed, np.flatnonzero(np.array(n_valid_between) >= _MIN_REPAIRED_BLOCKS) + 1):
        if len(group) < _MIN_FAILED_BLOCKS:
            continue
        before = np.flatnonzero(is_valid[: group[0]])
        after = group[-1] + np.flatnonzero(is_valid[group[-1] :])
        if len(before) >= _MIN_VALID_BLOCKS:
            is_repaired = len(after) >= _MIN_REPAIRED_BLOCKS
            last = edges[rotating[after[0]]] if is_repaired else len(table)
            mask[edges[rotating[before[-1]] + 1] : last] = True
    return mask


def _derotated_shares(table: Table) -> tuple[NDArray[np.int64], Array]:
    """Return the first rows of blocks, (B + 1,), and the derotated force over its rms, (B,).

    The share is NaN in a block in which gravity does not rotate.
    """
    t, rate = table.t, table["gz"]
    # A block without samples, as before a wild time stamp, is none.
    starts = np.flatnonzero(np.diff(np.floor((t - t[:1]) / _ROTATION_BLOCK_S))) + 1
    edges = np.concatenate([[0], starts, [len(t)]])
    angle = integrate_rate(t, rate)
    force = table["ax"] + 1j * table["ay"]
    shares = np.full(len(edges) - 1, np.nan)
    for block, (first, end) in enumerate(pairwise(edges.tolist())):
        if end - first < _MIN_ROTATION_SAMPLES:
            continue
        rms = float(np.std(force[first:end]))
        if _MIN_ROTATING_FORCE < rms < _MAX_ROTATING_FORCE:
            # The sign depends on the facing of the node.
            shares[block] = max(rotating_forces(angle[first:end], force[first:end])) / rms
    return edges, shares


def integrate_rate(t: Array, rate: Array) -> Array:
    """Return the angles, rad, at times (N,) s, of a rate in rad/s that is linear between samples."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])


def rotating_forces(angle: Array, force: Array) -> tuple[float, float]:
    """Return the sizes of the forces that rotate with the gyro and against it, m/s².

    angle: (N,) rad, integral of the rate. force: (N,) m/s², ax + i ay; its mean does not count.
    """
    force = force - force.mean()
    turn = np.exp(1j * angle)
    return float(np.abs(np.mean(force * turn))), float(np.abs(np.mean(force * turn.conj())))
