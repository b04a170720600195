"""Checks of wheel nodes before filtering: times, frozen sensors, clocks set back, mirrored axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array, find_runs
from hubodo.earth import STANDARD_GRAVITY
from hubodo.errors import InputError
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.gravity_rotation import MAX_GRAVITY_RATIO
from hubodo.fuse.wheel.gyro_failure import find_gyro_failure, integrate_rate, rotating_forces
from hubodo.fuse.wheel.preintegration import MAX_SAMPLE_STEP
from hubodo.fuse.wheel.thresholds import MIN_ROLLING_RATE
from hubodo.recording import Table
from hubodo.vehicle import facing_sign

_MIN_SAMPLE_STEP_S = 1.0 / 7000.0
"""s between samples at 7 kHz; the fastest rate of an LSM6DS33 is 6.66 kHz."""

_UNITS_PER_SECOND = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}

_MIN_FROZEN_S = 0.5
"""s without a change of any bit; sensor noise changes a bit of six axes within a few samples."""

_MIN_OTHER_RATE_SPREAD = 0.1
"""rad/s, standard deviation of the other wheel's rates above which the vehicle moves.

A thousand times the noise of an LSM6DS33 sample.
"""

_MIN_SIMULTANEOUS_SAMPLES = 3
"""Samples of a node meanwhile that show whether it turned."""

_MIN_FROZEN_TURN = 2.0
"""rad that a wheel turned by its mean rate meanwhile; gravity then changes its direction."""

_CROWDED_RUN_SAMPLES, _CROWDED_DURATION_SHARE = 20, 0.6
"""Number of samples, and the share of their usual duration below which they come from two interleaved
records.

Two records mixed one to one take half of the usual duration. Estimated.
"""

_MIN_BLOCKS, _MAX_BLOCKS = 5, 200
"""Wheel turns required for a verdict on mirrored axes, and those used at most. Estimated."""


def check_times(nodes: Mapping[str, Table], log: str) -> None:
    """Raise InputError if samples are too slow, in another unit, or if nodes have no common time."""
    for name, table in nodes.items():
        if len(table) < 3:
            continue
        step = float(np.median(np.diff(table.t)))
        if step <= MAX_SAMPLE_STEP:
            continue
        description = (
            f"{log}: {name}: samples are {step:g} s apart, from t = {table.t[0]:g} to {table.t[-1]:g} s"
        )
        for unit, per_second in _UNITS_PER_SECOND.items():
            if _MIN_SAMPLE_STEP_S <= step / per_second <= MAX_SAMPLE_STEP:
                raise InputError(f"{description}; they look like {unit}: divide t by {per_second:.0f}")
        raise InputError(f"{description}; a wheel needs {1.0 / MAX_SAMPLE_STEP:g} samples a second or more")
    names = [name for name, table in nodes.items() if len(table)]
    for first_name, second_name in combinations(names, 2):
        a, b = nodes[first_name].t, nodes[second_name].t
        if a[0] > b[-1] or b[0] > a[-1]:
            raise InputError(
                f"{log}: {first_name} lasts from t = {a[0]:.1f} to {a[-1]:.1f} s, {second_name} from "
                f"{b[0]:.1f} to {b[-1]:.1f} s: no time in common; put both on one clock, or fuse one alone "
                "with --nodes"
            )


def screen_samples(nodes: Mapping[str, Table]) -> tuple[dict[str, Table], tuple[str, ...]]:
    """Return the tables of all wheel nodes without rejected samples, and one line for each rejected run."""
    screened, lines = {}, []
    finite_nodes = {}
    for name, table in nodes.items():
        is_finite = np.asarray(np.isfinite(np.hstack([table.gyro, table.accel])).all(axis=1), np.bool_)
        finite_nodes[name] = table if is_finite.all() else _select(table, is_finite)
        if n_bad := len(table) - len(finite_nodes[name]):
            first = table.t[np.argmin(is_finite)]
            bad = f"{n_bad} of {len(table)} samples hold NaN or infinity"
            lines.append(f"{name}: {bad}, first at t = {first:.1f} s; left out")
    nodes = finite_nodes
    for name, table in nodes.items():
        others = [other for other_name, other in nodes.items() if other_name != name]
        interleaved, frozen = _find_interleaved(table.t), _find_frozen(table, others)
        frozen &= ~interleaved
        failed = find_gyro_failure(table) & ~(frozen | interleaved)
        for is_rejected, reason in (
            (interleaved, "samples of two times stand between one another: its clock went back"),
            (frozen, "not one bit of its samples changed while a wheel turned: it froze"),
            (
                failed,
                "gravity rotates otherwise than gz from here on: its gyro failed or changed its range",
            ),
        ):
            for first, end in find_runs(is_rejected):
                span = f"from t = {table.t[first]:.1f} to {table.t[end - 1]:.1f} s"
                lines.append(f"{name}: {span} {reason}; left out, sigmas grow there")
        is_accepted = ~(interleaved | frozen | failed)
        screened[name] = table if is_accepted.all() else _select(table, is_accepted)
    return screened, tuple(lines)


def _select(table: Table, chosen: NDArray[np.bool_]) -> Table:
    return Table({key: values[chosen] for key, values in table.columns.items()})


def find_own_gaps(tables: Sequence[Table]) -> list[list[float]]:
    """Return, for each table, the start times (s) of gaps that no other table has at the same time."""
    starts = [table.t[:-1][np.diff(table.t) > MAX_SAMPLE_STEP] for table in tables]
    mask = []
    for own in starts:
        others = np.concatenate([np.empty(0), *(other for other in starts if other is not own)])
        is_shared = np.abs(own[:, None] - others[None, :]) < MAX_SAMPLE_STEP
        mask.append(own[~is_shared.any(axis=1)].tolist())
    return mask


def _find_frozen(table: Table, others: list[Table]) -> NDArray[np.bool_]:
    """Return a mask (N,) of samples repeated for `_MIN_FROZEN_S` s or longer while a wheel turns.

    A noise-free simulation at standstill repeats samples too; there all wheels stand still. A logger that
    repeats its last messages freezes all nodes; their repeated rates then show that they turned, unless most
    of the samples are repeated, as in the test of a link.
    """
    mask = np.zeros(len(table), np.bool_)
    rows = np.hstack([table.gyro, table.accel])
    is_repeated = np.append(False, (rows[1:] == rows[:-1]).all(axis=1))
    usually_changes = np.count_nonzero(is_repeated) < 0.5 * len(table)
    for first, end in find_runs(is_repeated):
        start_t, end_t = table.t[first], table.t[end - 1]
        if end_t - start_t < _MIN_FROZEN_S:
            continue
        for other in [table, *others]:
            gyro = other.gyro[(other.t >= start_t) & (other.t <= end_t)]
            if len(gyro) < _MIN_SIMULTANEOUS_SAMPLES:
                continue
            angle = (end_t - start_t) * float(np.linalg.norm(gyro.mean(axis=0)))
            if gyro.std(axis=0).max() > _MIN_OTHER_RATE_SPREAD or (
                usually_changes and angle > _MIN_FROZEN_TURN
            ):
                mask[first:end] = True
    return mask


def _find_interleaved(t: Array) -> NDArray[np.bool_]:
    """Return a mask (N,) of interleaved samples.

    These are runs of `_CROWDED_RUN_SAMPLES` or more that follow each other much faster than most do.
    After a clock was set back, a log sorted by time interleaves the samples from before and after.
    """
    mask = np.zeros(len(t), np.bool_)
    if len(t) < 4 * _CROWDED_RUN_SAMPLES:
        return mask
    crowded = t[_CROWDED_RUN_SAMPLES:] - t[
        :-_CROWDED_RUN_SAMPLES
    ] < _CROWDED_DURATION_SHARE * _CROWDED_RUN_SAMPLES * float(np.median(np.diff(t)))
    for first in np.flatnonzero(crowded).tolist():
        mask[first : first + _CROWDED_RUN_SAMPLES + 1] = True
    return mask


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
    angle = integrate_rate(t, spin)
    coherence = [
        rotating_forces(angle[block], force[block]) for block in _blocks(t, angle, spin, node.gyro_limit)
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
