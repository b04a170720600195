"""What a solved graph says about its measurements: lasting errors, fixes that jumped, wheels that slipped."""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.solver import Solution

MIN_USED_WEIGHT = 0.4
"""Weight below which a measurement is worth a word: that of a fix five sigma off."""
_MAX_START_HEADING_SIGMA = 0.3
"""rad; 17 degrees, at which a track looks turned to the eye."""
_MIN_RESIDUALS = 60
"""Residuals, of both directions: 30 fixes, fewer say nothing about their own scatter."""
_GROWTH_SIGNIFICANCE_SIGMAS = 4.0
"""Sigmas of chance that an estimate of scatter or likeness must exceed."""
_MIN_SCATTER_GROWTH = 1.1
"""Times which fixes must scatter more than their sigma before it is widened: a tenth shows in no track."""
_MIN_FIXES_PER_ERROR = 1.2
"""Fixes that count as one before it is worth a word."""


def estimate_sigma_growth(
    graph: FactorGraph, solution: Solution, applied_growth: float
) -> tuple[float, list[str]]:
    """By which factor the fixes' sigma must grow to be honest, at least 1, and why.

    grown: the factor that the graph has already. Residuals of fixes in use that exceed their sigma say that
    the receiver promises too much; those that resemble their predecessors, that a hundred fixes do not tell
    a hundred times as much: the variance of a mean grows by 1 + 2 sum of the autocorrelations, summed until
    they vanish (Geyer 1992). Only what exceeds chance at four sigma counts.
    """
    positions = graph.find(PositionFactors)
    if positions is None:
        return applied_growth, []
    item = positions.linearise(solution.poses, solution.constants)
    use = item.residual[positions.loss.weight(item.squared_norms) > MIN_USED_WEIGHT] * applied_growth
    n = 2 * len(use)
    if n < _MIN_RESIDUALS:
        return applied_growth, []
    size = float(np.sqrt(np.mean(use**2)))
    growth, why = 1.0, []
    if size > _MIN_SCATTER_GROWTH and size**2 > 1.0 + _GROWTH_SIGNIFICANCE_SIGMAS * math.sqrt(2.0 / n):
        growth = size
        why.append(f"gnss: the fixes scatter {size:.1f} times as much as their sigma says; it was widened")
    shift = use - use.mean(axis=0)
    variance = float(np.mean(shift**2))
    lasting, lag = 1.0, 1
    while lag < len(use) // 4:
        correlation = float(np.mean(shift[lag:] * shift[:-lag])) / variance
        if correlation < _GROWTH_SIGNIFICANCE_SIGMAS / math.sqrt(n):
            break
        lasting += 2.0 * correlation
        lag += 1
    if lasting > _MIN_FIXES_PER_ERROR:
        growth *= math.sqrt(lasting)
        why.append(
            f"gnss: the errors of successive fixes are alike, {lasting:.0f} count as one; sigmas were widened"
        )
    return growth, why


def review_solution(graph: FactorGraph, solution: Solution, pose_t: Array, heading_known: bool) -> list[str]:
    """One line for each thing in a solved graph (with covariance) that a user should know."""
    said: list[str] = []
    for factor in graph.factors:
        item = factor.linearise(solution.poses, solution.constants)
        out = factor.loss.weight(item.squared_norms) < MIN_USED_WEIGHT
        said += factor.describe_outliers(out, np.sqrt(item.squared_norms), pose_t)
    blunt = math.sqrt(float(solution.covariance[0, 2, 2]))
    if blunt > _MAX_START_HEADING_SIGMA:
        cause = "nothing measures it" if not heading_known else "the fixes are too few or too close together"
        said.append(f"heading: known to {math.degrees(min(blunt, math.pi)):.0f} degrees only: {cause}")
    if not solution.converged:
        said.append(f"graph: not settled after {solution.iterations} steps; check the sigmas of the fixes")
    return said
