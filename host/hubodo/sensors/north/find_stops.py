"""What a turntable did, from the gyro on it alone: when it turned, by how much, and where it stood."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.north.stops import TableMotion

Mask = NDArray[np.bool_]

LOOKS = ((0.2, np.radians(0.25)), (2.0, np.radians(0.04)))
"""(s of a mean, rad/s): means that stand out by more than this and by SIGMAS are a turn.

Fast turns show in short means; slow ones only in long ones, which are taken of what is left. The least rates
are beyond what the bias of a gyro changes by from one stop to the next.
"""
SIGMAS = 8.0
BASE_S, MAX_DRIFT = 30.0, np.radians(1.0)
"""The bias is looked at in three times these s, every so many; it drifts less than this, rad/s."""
BRIDGE_S = 0.6
"""Two turns with less than this between them are one."""
BIAS_S = 10.0
"""Of the stops before and after a turn, whose means are the bias in it."""
ASIDE_S = 1.5
"""At either end of a stop, where a slow turn may hide."""
MAX_HIDDEN_S = 3.0
ROW_ANGLE = np.radians(30)
MAX_LEAN = np.radians(20.0)
_MODE_SHARE = 0.2
_ASIDE, _ASIDE_ANGLE = 0.1, np.radians(3.0)
_OFF_STEP = np.radians(1.0)


@dataclass(frozen=True)
class Turn:
    """Samples [first, last) turn by (3,) rad in node axes.

    path: (last - first, 3) rad, from its beginning on. sigma: rad, of its size, without that of the scale.
    """

    first: int
    last: int
    by: Array
    path: Array
    sigma: float

    def rows(self, t: Array, axis: Array, begin: float, end: float) -> list[tuple[float, float, float]]:
        """t, angle and moving as a table would tell them, every ROW_ANGLE or so, from begin to end, rad."""
        share = self.path @ axis / float(self.by @ axis)
        count = max(2, int(abs(end - begin) / ROW_ANGLE) + 1)
        some = np.linspace(0, len(share) - 1, count).astype(int)
        return [(float(t[self.first + k]), begin + (end - begin) * float(share[k]), 1.0) for k in some]


def find_motion(
    t: Array,
    gyro: Array,
    up: Array,
    *,
    scale_sigma: float,
    step: float | None = None,
    limit: float = np.inf,
) -> TableMotion:
    """The table's motion, its angle counted from where it stood first.

    t: (N,) s. gyro: (N, 3) rad/s. up: (3,) unit vector in node axes. scale_sigma: 1 sigma of the relative
    error of the gyro's scale. step: rad, of a table that stops at multiples of it only; then its angles are
    exact. limit: rad/s from which on a sample is clipped. Raises InputError with the time: no turn, turns
    about another axis, an angle that is no multiple, a gap in a turn, a turn too fast for the gyro.
    """
    moving = _moving(t, gyro)
    turns = _turns(t, gyro, moving)
    if not turns:
        raise InputError(
            "the table never turned from one stop to the next (one that turns all the time needs table.csv); "
            "north needs stops that look different ways, or --simulate-azimuth-deg to try a gyro at rest"
        )
    if step is None:
        _check_clipped(t, gyro, turns, limit)
    axis = _axis(t, turns, up)
    by = np.array([float(turn.by @ axis) for turn in turns])
    angle = np.concatenate([[0.0], np.cumsum(by)])
    if step is not None:
        angle, scale_sigma = _rounded(t, turns, by, step, scale_sigma), 0.0
    sigma = float(np.sqrt(np.mean([turn.sigma**2 for turn in turns]))) if step is None else 0.0
    rows = [(float(t[0]), 0.0, 0.0)] if turns[0].first else []
    for turn, begin, end in zip(turns, angle[:-1], angle[1:], strict=True):
        rows += turn.rows(t, axis, begin, end)
        if turn.last < len(t):
            rows.append((float(t[turn.last]), end, 0.0))
    made = np.array(rows)
    return TableMotion(made[:, 0], made[:, 1], made[:, 2] > 0.5, scale_sigma, sigma)


def _moving(t: Array, gyro: Array) -> Mask:
    """(N,) whether the table moves, to the width of a mean."""
    step = float(np.median(np.diff(t)))
    moving = np.zeros(len(t), bool)
    base = _base(gyro, step)
    for seconds, least in LOOKS:
        width = max(1, round(seconds / step))
        found = np.zeros(len(t), bool)
        for i, j in runs(~moving):
            own = np.median(gyro[i:j], axis=0) if moving.any() else base[i:j]
            found[i:j] = _stands_out(gyro[i:j] - own, width, least)
        moving |= found
    return _widened(_bridged(moving, round(BRIDGE_S / step)), gyro - base, step)


def _check_clipped(t: Array, gyro: Array, turns: list[Turn], limit: float) -> None:
    for turn in turns:
        if np.abs(gyro[turn.first : turn.last]).max() >= limit:
            raise InputError(
                f"the gyro is at the end of its range in the turn at {t[turn.first]:.1f} s, so its angle is "
                "not known; turn slower, give table.csv, or say with --step-deg where the table stops"
            )


def _base(gyro: Array, step: float) -> Array:
    """(N, 3) rad/s: the bias as it drifts after power-on, from the densest rates of each minute or so.

    A minute in which the table hardly stood is densest where it turned; that is no drift of a gyro.
    """
    width = max(1, round(LOOKS[0][0] / step))
    means = _means(gyro, width)
    common = np.array([_mode(channel) for channel in means.T])
    hop = max(1, round(BASE_S / (width * step)))
    at, found = [], []
    for i in range(0, max(1, len(means) - hop), hop):
        here = np.array([_mode(channel) for channel in means[i : i + 3 * hop].T])
        if np.linalg.norm(here - common) < MAX_DRIFT:
            at.append((i + min(1.5 * hop, (len(means) - i) / 2)) * width)
            found.append(here)
    if not found:
        return np.tile(common, (len(gyro), 1))
    rows = np.arange(len(gyro))
    return np.column_stack([np.interp(rows, at, channel) for channel in np.array(found).T])


def _stands_out(off: Array, width: int, least: float) -> Mask:
    """(N,) samples of means that stand out from zero by more than noise."""
    made = np.zeros(len(off), bool)
    means = _means(off, width)
    if len(means) < 3:
        return made
    steps = np.diff(means, axis=0)
    noise = float(np.linalg.norm(1.4826 * np.median(np.abs(steps), axis=0))) / np.sqrt(2)
    loud = np.linalg.norm(means, axis=1) > max(least, SIGMAS * noise)
    # A turn that begins late in a mean hides in it: its neighbours go with it.
    near = loud.copy()
    near[:-1] |= loud[1:]
    near[1:] |= loud[:-1]
    made[: len(near) * width] = np.repeat(near, width)
    made[len(near) * width :] = bool(near[-1])
    return made


def _means(values: Array, width: int) -> Array:
    whole = len(values) // width * width
    return np.asarray(values[:whole].reshape(-1, width, values.shape[1]).mean(axis=1))


def _mode(values: Array) -> float:
    """Where values are densest: the middle of the shortest interval with a fifth of them."""
    ordered = np.sort(values)
    count = max(2, int(_MODE_SHARE * len(ordered)))
    if len(ordered) <= count:
        return float(np.median(ordered))
    at = int((ordered[count:] - ordered[:-count]).argmin())
    return float(ordered[at : at + count].mean())


def runs(mask: Mask) -> list[tuple[int, int]]:
    """[first, one past the last) of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _bridged(moving: Mask, width: int) -> Mask:
    made = moving.copy()
    for (_, end), (begin, _) in pairwise(runs(moving)):
        if begin - end < width:
            made[end:begin] = True
    return made


def _widened(moving: Mask, off: Array, step: float) -> Mask:
    """With the ends of slow turns, in which a rate that rises and falls like a sine squared hides.

    It is below a share s of its peak for the first arcsin(sqrt(s)) / pi of the turn. off: rad/s from bias.
    """
    made = moving.copy()
    for i, j in runs(moving):
        peak = 2 * float(np.linalg.norm(off[i:j].mean(axis=0)))
        hidden = np.arcsin(np.sqrt(min(1.0, LOOKS[0][1] / max(peak, 1e-9)))) / np.pi * (j - i)
        reach = round(min(hidden, MAX_HIDDEN_S / step))
        made[max(0, i - reach) : j + reach] = True
    return made


def _turns(t: Array, gyro: Array, moving: Mask) -> list[Turn]:
    step = float(np.median(np.diff(t)))
    still = runs(~moving)
    reach, aside = round(BIAS_S / step), round(ASIDE_S / step)
    before, after, margin = {}, {}, {}
    for i, j in still:
        # What turns too slowly to be seen yet is part of the turn, not of the bias.
        margin[i] = margin[j] = off = min(aside, (j - i) // 4)
        before[j] = gyro[max(i + off, j - off - reach) : j - off].mean(axis=0)
        after[i] = gyro[i + off : min(j - off, i + off + reach)].mean(axis=0)
    spans = runs(moving)
    leaps = [np.linalg.norm(after[j] - before[i]) for i, j in spans if i in before and j in after]
    drift = float(np.sqrt(np.mean(np.square(leaps)))) / 2 if leaps else 0.0
    density = _density(gyro, still, step)
    made = []
    for i, j in spans:
        first, last = max(0, i - 1), min(j + 1, len(t))
        if float(np.diff(t[first:last]).max(initial=0.0)) > max(5 * step, 0.1):
            raise InputError(
                f"samples are missing in the turn at {t[i]:.1f} s, so its angle is not known; give table.csv "
                "or repeat the recording"
            )
        bias = (before.get(i, after.get(j, 0.0)) + after.get(j, before.get(i, 0.0))) / 2
        first, last = max(0, i - margin.get(i, 0)), min(j + margin.get(j, 0), len(t))
        path = cumulative_trapezoid(gyro[first:last] - bias, t[first:last], axis=0, initial=0)
        length = float(t[last - 1] - t[first])
        sigma = float(np.hypot(density * np.sqrt(length), drift * length))
        made.append(Turn(i, j, path[-1], path[i - first : j - first], sigma))
    return made


def _density(gyro: Array, still: list[tuple[int, int]], step: float) -> float:
    """rad/sqrt(s): white noise of the axes together, from means of a fifth of a second of the stops."""
    width = max(1, round(LOOKS[0][0] / step))
    steps = [np.diff(_means(gyro[i:j], width), axis=0) for i, j in still if j - i >= 3 * width]
    if not steps:
        return 0.0
    joined = np.concatenate(steps)
    return float(np.sqrt(np.median(joined**2, axis=0).max() / 0.4549 / 2 * width * step))


def _axis(t: Array, turns: list[Turn], up: Array) -> Array:
    """(3,) the table's axis in node axes, upwards. Raises InputError where turns have no common one."""
    by = np.array([turn.by for turn in turns])
    axis = np.linalg.eigh(by.T @ by)[1][:, -1]
    lean = float(np.arccos(min(1.0, abs(float(axis @ up)))))
    if lean > MAX_LEAN:
        raise InputError(
            f"the table turns about an axis that leans by {np.degrees(lean):.0f} degrees from the vertical: "
            "gravity then turns with it and outweighs Earth rate; level the table"
        )
    axis = np.asarray(axis * np.sign(axis @ up))
    for turn in turns:
        aside = float(np.linalg.norm(turn.by - (turn.by @ axis) * axis))
        if aside > max(_ASIDE * float(np.linalg.norm(turn.by)), _ASIDE_ANGLE):
            raise InputError(
                f"at {t[turn.first]:.1f} s the node turned by {np.degrees(aside):.0f} degrees about another "
                "axis than the table's; leave out what comes before or after, or repeat the recording"
            )
    return axis


def _rounded(t: Array, turns: list[Turn], by: Array, step: float, scale_sigma: float) -> Array:
    """(turns + 1,) rad: where a table with fixed stops stood; what is far less than a step stays as felt."""
    angle = [0.0]
    for turn, felt in zip(turns, by, strict=True):
        reached = angle[-1] + float(felt)
        whole = step * round(reached / step)
        if abs(felt) < step / 4:
            angle.append(reached)
            continue
        if abs(reached - whole) > min(3 * scale_sigma * abs(felt) + _OFF_STEP, step / 3):
            raise InputError(
                f"the turn at {t[turn.first]:.1f} s went by {np.degrees(felt):.1f} degrees, to "
                f"{np.degrees(reached):.1f}, which is no multiple of {np.degrees(step):g}; leave --step-deg "
                "out, or give the step that the table has"
            )
        angle.append(whole)
    return np.array(angle)
