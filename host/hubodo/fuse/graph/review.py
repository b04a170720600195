"""Review of a solved graph: correlated fix errors, outliers, slip, and an unobservable heading."""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.solver import Solution

MIN_USED_WEIGHT = 0.4
"""Weight below which a measurement is reported as an outlier: that of a fix five sigma off."""
_MAX_START_HEADING_SIGMA = 0.3
"""rad; at 17 degrees a track looks rotated to the eye."""
_MIN_RESIDUALS = 60
"""Residuals, two for each of 30 fixes; fewer do not determine their own scatter."""
_GROWTH_SIGNIFICANCE_SIGMAS = 4.0
"""Sigmas of chance that an estimate of scatter or correlation must exceed."""
_MIN_SCATTER_GROWTH = 1.1
"""Ratio of scatter to sigma from which the sigma is inflated; a tenth shows in no track."""
_MIN_FIXES_PER_ERROR = 1.2
"""Fixes that count as one from which correlation is reported."""


def estimate_sigma_growth(
    graph: FactorGraph, solution: Solution, applied_growth: float
) -> tuple[float, list[str]]:
    """Return the factor, at least 1, on the sigmas of fixes that makes them consistent, and the reasons.

    applied_growth: the factor that the graph already has. Residuals of used fixes that exceed their sigma
    show that the receiver is overconfident. If they are correlated in time, n fixes carry less information
    than n independent ones: the variance of a mean grows by 1 + 2 sum of the autocorrelations, summed until
    they vanish (Geyer 1992). Only an excess beyond four sigma of chance counts.
    """
    positions = graph.find_group(PositionFactors)
    if positions is None:
        return applied_growth, []
    linearised = positions.linearise(solution.poses, solution.constants)
    residuals = (
        linearised.residual[positions.loss.weight(linearised.squared_norms) > MIN_USED_WEIGHT]
        * applied_growth
    )
    n = 2 * len(residuals)
    if n < _MIN_RESIDUALS:
        return applied_growth, []
    scatter = float(np.sqrt(np.mean(residuals**2)))
    growth, reasons = 1.0, []
    if scatter > _MIN_SCATTER_GROWTH and scatter**2 > 1.0 + _GROWTH_SIGNIFICANCE_SIGMAS * math.sqrt(2.0 / n):
        growth = scatter
        reasons.append(
            f"gnss: the fixes scatter {scatter:.1f} times as much as their sigma says; it was widened"
        )
    centred = residuals - residuals.mean(axis=0)
    variance = float(np.mean(centred**2))
    fixes_per_error, lag = 1.0, 1
    while lag < len(residuals) // 4:
        correlation = float(np.mean(centred[lag:] * centred[:-lag])) / variance
        if correlation < _GROWTH_SIGNIFICANCE_SIGMAS / math.sqrt(n):
            break
        fixes_per_error += 2.0 * correlation
        lag += 1
    if fixes_per_error > _MIN_FIXES_PER_ERROR:
        growth *= math.sqrt(fixes_per_error)
        reasons.append(
            f"gnss: the errors of successive fixes are correlated, {fixes_per_error:.0f} count as one; "
            "sigmas were widened"
        )
    return growth, reasons


def review_solution(
    graph: FactorGraph, solution: Solution, pose_t: Array, heading_observable: bool
) -> list[str]:
    """Return one warning for each finding in a graph solved with covariance."""
    warnings: list[str] = []
    for factor in graph.factors:
        linearised = factor.linearise(solution.poses, solution.constants)
        is_outlier = factor.loss.weight(linearised.squared_norms) < MIN_USED_WEIGHT
        warnings += factor.describe_outliers(is_outlier, np.sqrt(linearised.squared_norms), pose_t)
    heading_sigma = math.sqrt(float(solution.covariance[0, 2, 2]))
    if heading_sigma > _MAX_START_HEADING_SIGMA:
        cause = (
            "nothing measures it" if not heading_observable else "the fixes are too few or too close together"
        )
        warnings.append(
            f"heading: known to {math.degrees(min(heading_sigma, math.pi)):.0f} degrees only: {cause}"
        )
    if not solution.converged:
        warnings.append(
            f"graph: not converged after {solution.iterations} iterations; check the sigmas of the fixes"
        )
    return warnings
