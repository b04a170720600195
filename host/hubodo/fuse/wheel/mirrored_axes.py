"""Axes of a node that form a mirror image: gravity rotates against the gyro about the axle."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.gravity_rotation import MAX_GRAVITY_RATIO
from hubodo.fuse.wheel.thresholds import MIN_ROLLING_RATE
from hubodo.recording import Table
from hubodo.vehicle import facing_sign

_MIN_BLOCKS, _MAX_BLOCKS = 5, 200
"""Blocks required for a verdict, and those used at most. Estimated."""


def correct_mirrored_axes(
    config: WheelConfig, nodes: Mapping[str, Table]
) -> tuple[dict[str, Table], tuple[str, ...]]:
    """Return the nodes, with y negated where axes are mirrored, and a warning for each mirrored node.

    Exchanged x and y, or one of them negated, are the same mirror image up to the wheel angle, which is
    initialised from gravity.
    """
    corrected, warnings = dict(nodes), []
    for name, node in config.nodes.items():
        table = nodes.get(name)
        if table is None or not is_mirrored(node, table):
            continue
        columns = dict(table.columns)
        columns |= {key: -columns[key] for key in ("gy", "ay")}
        corrected[name] = Table(columns)
        warnings.append(
            f"{name}: gravity rotates against gz: x and y of the node are exchanged, or one of them is "
            "negated; y is negated here. Correct the axes of the node or its driver"
        )
    return corrected, tuple(warnings)


def is_mirrored(node: WheelNode, table: Table) -> bool:
    """Return True if gravity in ax, ay rotates against gz."""
    t, spin = table.t, facing_sign(node.facing) * table.gyro[:, 2]
    force = table.accel[:, 0] + 1j * facing_sign(node.facing) * table.accel[:, 1]
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (spin[1:] + spin[:-1]) * np.diff(t))])
    coherence = [
        _rotating_forces(angle[block], force[block]) for block in _blocks(t, angle, spin, node.gyro_limit)
    ]
    if len(coherence) < _MIN_BLOCKS:
        return False
    forward, backward = np.median(coherence, axis=0)
    # However unequal the scales of both axes are, (sx + sy) / 2 is not below |sx - sy| / 2.
    return bool(backward > max(STANDARD_GRAVITY / MAX_GRAVITY_RATIO, forward))


def _blocks(t: Array, angle: Array, spin: Array, gyro_limit: float) -> list[slice]:
    """Return the slices of samples, without gaps, of one wheel turn each.

    In a whole turn constant forces and the centripetal force of a steady spin average out.
    """
    blocks: list[slice] = []
    start = 0
    turned = 2.0 * np.pi
    while start < len(t) - 1 and len(blocks) < _MAX_BLOCKS:
        end = start + int(np.argmax(np.abs(angle[start:] - angle[start]) >= turned))
        if end == start:
            break
        duration = t[end] - t[start]
        is_clipped = bool(np.any(np.abs(spin[start:end]) >= gyro_limit))
        has_gap = bool(np.max(np.diff(t[start : end + 1])) > 0.25 * duration)
        if turned / duration > MIN_ROLLING_RATE and not is_clipped and not has_gap:
            blocks.append(slice(start, end))
        start = end
    return blocks


def _rotating_forces(angle: Array, force: Array) -> tuple[float, float]:
    """Return the sizes of the forces that rotate with the gyro and against it, m/s²."""
    force = force - force.mean()
    turn = np.exp(1j * angle)
    return float(np.abs(np.mean(force * turn))), float(np.abs(np.mean(force * turn.conj())))
