"""Uneven codes of a converter in standstills: errors of the gyro bias, and of accelerometers in each pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc, fdtrc, ndtr

from hubodo.arrays import Array
from hubodo.sensors.imu.quantisation import find_quantisation_steps
from hubodo.sensors.imu.standstills import Standstills

_MIN_POSES = 8
_SCATTER_RANGE = (0.5, 10.0)
"""Scatter of the samples, steps: below it rounding hides their density, above it widths average out."""
_MIN_CODE_COUNT = 60.0
_MIN_UNEVENNESS, _MAX_CHANCE = 0.1, 1e-5
_DENSITY_PARAMETERS = 3
"""Count, mean and standard deviation of the normal density."""
_ROUNDING_VARIANCE = 1.0 / 12.0
_MIN_POSE_CODE_COUNT = 20.0
"""Expected count from which a code is judged in one pose."""


def uneven_code_sigma(gyro: Array, standstills: Standstills, notes: list[str]) -> Array:
    """Return the (3,) sigmas of the gyro bias due to uneven or missing codes, rad/s, and note their cause.

    gyro: (N, 3) rad/s. At standstill all poses use the same few codes, so the mean of the poses does not
    reduce their error. In each pose, the count of a code is compared with that of even codes and normal
    noise; the scatter from pose to pose shows which mean differences are due to chance. The axes are pooled,
    because few codes occur in each and converters of one chip are alike.
    """
    steps = find_quantisation_steps(gyro)
    if len(standstills) < _MIN_POSES or not steps.any():
        return np.zeros(3)
    scatter = np.zeros(3)
    axes = []
    for k in np.flatnonzero(steps):
        spans = zip(standstills.start, standstills.end, strict=True)
        poses = [np.rint(gyro[i:j, k] / steps[k]) for i, j in spans if j > i + 1]
        scatter[k] = _white_scatter(poses)
        if _SCATTER_RANGE[0] <= scatter[k] <= _SCATTER_RANGE[1]:
            axes.append(_code_deviations(poses, float(scatter[k])))
    axes = [it for it in axes if it.shape[1] > _DENSITY_PARAMETERS]
    if not axes:
        return np.zeros(3)
    deviation, sigma = np.concatenate(axes, axis=1)
    dof = len(deviation) - _DENSITY_PARAMETERS * len(axes)
    chance = fdtrc(dof, len(standstills) - 1, float(((deviation / sigma) ** 2).sum()) / dof)
    unevenness = math.sqrt(max(0.0, float((deviation**2 - sigma**2).sum()) / dof))
    if chance > _MAX_CHANCE or unevenness < _MIN_UNEVENNESS:
        return np.zeros(3)
    result = _sigma_of_means(steps, scatter, unevenness)
    text = ", ".join(f"{math.degrees(it) * 3600.0:.3g}" for it in result)
    codes = describe_uneven_codes("gyros'", unevenness, f"{math.degrees(float(steps.max())):.3g} deg/s")
    notes.append(
        f"{codes}, an error of the bias that is the same in all poses: the sigmas include {text} °/h for it"
    )
    return result


def widen_accelerometers(accel: Array, standstills: Standstills) -> Standstills:
    """Return the standstills with the error of uneven or missing codes in the sigmas of the accelerometers.

    accel: (N, 3) m/s². Each pose uses other codes, so that the error of its mean is independent.
    """
    spans = list(zip(standstills.start.tolist(), standstills.end.tolist(), strict=True))
    uneven, unevenness, step = uneven_mean_sigma(accel, spans)
    if not unevenness:
        return standstills
    codes = describe_uneven_codes("accelerometers'", unevenness, f"{step:.3g} m/s²")
    note = f"{codes}: the sigmas include it"
    sigma = np.hypot(standstills.accel_sigma, uneven)
    return replace(standstills, accel_sigma=sigma, rejected=(*standstills.rejected, note))


def describe_uneven_codes(owner: str, unevenness: float, step: str) -> str:
    """Return the beginning of a remark; owner: such as "gyro's"; step: of the converter, with its unit."""
    return f"the codes of the {owner} converter are uneven by {unevenness:.0%} (1σ; steps of {step})"


def uneven_mean_sigma(values: Array, spans: Sequence[tuple[int, int]]) -> tuple[Array, float, float]:
    """Return the errors (1σ) of a mean over uneven codes, (C,), their unevenness, and the largest step.

    values: (N, C). spans: those of constant values, whose counts of codes are compared with those of even
    codes and normal noise. Errors and unevenness are 0 where chance explains the counts.
    """
    steps = find_quantisation_steps(values)
    scatter, misfit, total_dof, excess, squares = np.zeros(len(steps)), 0.0, 0, 0.0, 0.0
    for k in np.flatnonzero(steps):
        parts = [np.rint(values[i:j, k] / steps[k]) for i, j in spans if j > i + 1]
        scatter[k] = _white_scatter(parts)
        if not _SCATTER_RANGE[0] <= scatter[k] <= _SCATTER_RANGE[1]:
            continue
        for part in parts:
            difference, expected = _code_counts(part, float(scatter[k]))
            misfit += float((difference**2 / expected).sum())
            total_dof += len(expected)
            excess += float((difference**2 - expected).sum())
            squares += float((expected**2).sum())
    unevenness = math.sqrt(max(0.0, excess / squares)) if squares else 0.0
    if unevenness < _MIN_UNEVENNESS or chdtrc(total_dof, misfit) > _MAX_CHANCE:
        return np.zeros(len(steps)), 0.0, 0.0
    return _sigma_of_means(steps, scatter, unevenness), unevenness, float(steps.max())


def _white_scatter(poses: list[Array]) -> float:
    """Return the standard deviation of the noise before rounding, in steps."""
    return math.sqrt(max(0.0, float(np.mean([it.var(ddof=1) for it in poses])) - _ROUNDING_VARIANCE))


def _sigma_of_means(steps: Array, scatter: Array, unevenness: float) -> Array:
    """Return the (C,) errors (1σ) of a mean over few codes whose widths are uneven.

    A width is the difference of two edges. The errors e of independent edges move the mean by the sum of e
    times the density there: rms e sqrt(1 / (2 sqrt(pi) s)) for normal noise of s steps.
    """
    density = 1.0 / np.sqrt(2.0 * math.sqrt(math.pi) * np.maximum(scatter, _SCATTER_RANGE[0]))
    return np.asarray(steps * density * unevenness / math.sqrt(2.0))


def _code_counts(pose: Array, scatter: float) -> tuple[Array, Array]:
    """Return the counts of the codes of a pose minus the expected ones, and the expected ones, (C,)."""
    codes = np.arange(pose.min(), pose.max() + 1.0)
    edges = np.append(codes - 0.5, codes[-1] + 0.5)
    sigma = math.sqrt(max(pose.var(ddof=1) - _ROUNDING_VARIANCE, (0.5 * scatter) ** 2))
    expected = len(pose) * np.diff(ndtr((edges - pose.mean()) / sigma))
    difference = np.bincount((pose - codes[0]).astype(np.int64), minlength=len(codes)) - expected
    used = expected > _MIN_POSE_CODE_COUNT
    return np.asarray(difference[used]), np.asarray(expected[used])


def _code_deviations(poses: list[Array], scatter: float) -> Array:
    """Return the relative deviations of the widths of the codes and their sigmas, (2, C)."""
    codes = np.arange(min(it.min() for it in poses), max(it.max() for it in poses) + 1.0)
    difference, expected = np.zeros((2, len(poses), len(codes)))
    edges = np.append(codes - 0.5, codes[-1] + 0.5)
    for k, pose in enumerate(poses):
        sigma = math.sqrt(max(pose.var(ddof=1) - _ROUNDING_VARIANCE, (0.5 * scatter) ** 2))
        expected[k] = len(pose) * np.diff(ndtr((edges - pose.mean()) / sigma))
        difference[k] = np.bincount((pose - codes[0]).astype(np.int64), minlength=len(codes)) - expected[k]
    total = expected.sum(axis=0)
    used = total > _MIN_CODE_COUNT
    total, difference = total[used], difference[:, used]
    chance = np.maximum(difference.std(axis=0, ddof=1) * math.sqrt(len(poses)), np.sqrt(total))
    return np.asarray(np.stack([difference.sum(axis=0), chance]) / total)
