"""Alignment of odometry with GNSS fixes, section by section, as the initial guess of the graph's poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.between import ComplexArray

_N_FIX_PAIRS = 64
"""Pairs of fixes tried in a section.

With half of all fixes wrong, one pair in four consists of two good ones, and all 64 fail in one section of
1e8.
"""
_MAX_TURN_SIGMA = 0.1
"""rad, 1 sigma of a section's rotation, from which Gauss-Newton converges."""
_INLIER_SIGMAS = 3.0
"""Sigmas within which a fix agrees with a rotation and shift."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Odometry aligned with the fixes, at the time of each fix.

    Attributes
    ----------
    turn : (n,) rad to add to the odometry's heading.
    position : (n,) complex, m; the aligned odometry.
    turn_observable : whether any section was long enough to determine a rotation.
    """

    turn: Array
    position: ComplexArray
    turn_observable: bool


def align_odometry(odometry: ComplexArray, fixes: ComplexArray, sigma: Array) -> Alignment:
    """Return rotation and shift of odometry positions (n,) onto simultaneous fixes (n,) with sigma (n,) m.

    Each section is just long enough to determine its rotation to 0.1 rad. In it the rotation and shift that
    most fixes agree with are searched among pairs of fixes far apart (RANSAC, Fischler and Bolles 1981, with
    pairs from a fixed sequence), then refined by weighted least squares on those fixes (closed form in the
    plane). So neither outliers nor a heading that drifts by whole turns in an hour mislead it.
    """
    n = len(odometry)
    section_turns, section_weights, section_centres, odometry_means, fix_means = [], [], [], [], []
    start = 0
    while start < n:
        end = _find_section_end(odometry, sigma, start)
        if n - end < (end - start) // 2:
            end = n
        odometry_part, fix_part = odometry[start:end], fixes[start:end]
        inliers = _find_inliers(odometry_part, fix_part, sigma[start:end])
        if np.count_nonzero(inliers) >= 2:
            odometry_part, fix_part, sigma_part = (
                odometry_part[inliers],
                fix_part[inliers],
                sigma[start:end][inliers],
            )
            information = sigma_part**-2.0
            odometry_mean, fix_mean = (
                np.average(odometry_part, weights=information),
                np.average(fix_part, weights=information),
            )
            product = np.sum(information * np.conj(odometry_part - odometry_mean) * (fix_part - fix_mean))
            section_turns.append(float(np.angle(product)))
            # The information on the rotation is that of the fixes times their squared lever arms.
            section_weights.append(float(np.sum(information * np.abs(odometry_part - odometry_mean) ** 2)))
            section_centres.append(float(start + np.flatnonzero(inliers).mean()))
            odometry_means.append(complex(odometry_mean))
            fix_means.append(complex(fix_mean))
        start = end
    informative = [index for index, weight in enumerate(section_weights) if weight > 1.0]
    if not informative:
        fix_median = complex(np.median(fixes.real), np.median(fixes.imag))
        odometry_median = complex(np.median(odometry.real), np.median(odometry.imag))
        return Alignment(np.zeros(n), fix_median + odometry - odometry_median, False)
    known_turns = np.unwrap([section_turns[index] for index in informative])
    heading = np.interp(np.arange(n), [section_centres[index] for index in informative], known_turns)
    nearest_section = np.abs(np.arange(n)[:, None] - np.array(section_centres)[None, :]).argmin(axis=1)
    place = np.array(fix_means)[nearest_section] + np.exp(1j * heading) * (
        odometry - np.array(odometry_means)[nearest_section]
    )
    return Alignment(heading, place, True)


def _find_section_end(odometry: ComplexArray, sigma: Array, start: int) -> int:
    """Return the end of a section that starts at `start` and is long enough to determine its rotation."""
    n, count = len(odometry), 8
    while start + count < n:
        section = odometry[start : start + count]
        information = np.sum(np.abs(section - section.mean()) ** 2 / sigma[start : start + count] ** 2)
        if information > 1.0 / _MAX_TURN_SIGMA**2:
            return start + count
        count = int(count * 1.5)
    return n


def _find_inliers(
    odometry: ComplexArray, fixes: ComplexArray, sigma: Array
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return a flag (n,) for each fix that agrees with the rotation and shift of the majority."""
    n = len(odometry)
    if n < 3:
        return np.ones(n, np.bool_)
    # Multiples of the golden ratio spread the pairs evenly over the section, without random numbers.
    k = np.arange(1, _N_FIX_PAIRS + 1)
    first = (k * 0.6180339887 % 1.0 * n).astype(np.intp)
    second = (first + (0.25 + 0.5 * (k * 0.7548776662 % 1.0)) * n).astype(np.intp) % n
    odometry_pair, fix_pair = odometry[second] - odometry[first], fixes[second] - fixes[first]
    rotation = np.exp(1j * np.angle(fix_pair * np.conj(odometry_pair)))
    distance = np.abs(
        0.5 * (fixes[first] + fixes[second])[:, None]
        + rotation[:, None] * (odometry[None, :] - 0.5 * (odometry[first] + odometry[second])[:, None])
        - fixes[None, :]
    )
    score = np.minimum((distance / sigma) ** 2, _INLIER_SIGMAS**2 * 2.0).sum(axis=1)
    inliers = distance[int(np.argmin(score))] < 2.0 * _INLIER_SIGMAS * sigma
    for _ in range(3):
        if np.count_nonzero(inliers) < 2:
            return np.ones(n, np.bool_)
        odometry_mean, fix_mean = odometry[inliers].mean(), fixes[inliers].mean()
        refined_rotation = np.exp(
            1j * np.angle(np.sum(np.conj(odometry[inliers] - odometry_mean) * (fixes[inliers] - fix_mean)))
        )
        inliers = (
            np.abs(fix_mean + refined_rotation * (odometry - odometry_mean) - fixes)
            < 1.5 * _INLIER_SIGMAS * sigma
        )
    return np.asarray(inliers) if np.count_nonzero(inliers) >= 2 else np.ones(n, np.bool_)
