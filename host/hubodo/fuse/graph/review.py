"""What a solved graph says about its measurements: errors that last, fixes that jumped, wheels that broke
away."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.graph.solver import Graph, Solution

_OUT = 0.4
_BLUNT_HEADING = 0.3


def error_growth(graph: Graph, solution: Solution, grown: float) -> tuple[float, list[str]]:
    """By which factor the fixes' sigma must grow to be honest, at least 1, and why.

    grown: the factor that the graph has already. Residuals of fixes in use that exceed their sigma say that
    the receiver promises too much; those that resemble their predecessors, that a hundred fixes do not tell
    a hundred times as much: the variance of a mean grows by 1 + 2 sum of the autocorrelations, summed until
    they vanish (Geyer 1992). Only what exceeds chance at four sigma counts.
    """
    if graph.positions is None:
        return grown, []
    residual = graph.positions.linear(solution.poses, solution.constants).residual
    weight = graph.losses.position.weight(np.einsum("ij,ij->i", residual, residual))
    use = residual[weight > _OUT] * grown
    n = 2 * len(use)
    if n < 60:
        return grown, []
    size = float(np.sqrt(np.mean(use**2)))
    growth, why = 1.0, []
    if size > 1.1 and size**2 > 1.0 + 4.0 * math.sqrt(2.0 / n):
        growth = size
        why.append(f"gnss: the fixes scatter {size:.1f} times as much as their sigma says; it was widened")
    shift = use - use.mean(axis=0)
    variance = float(np.mean(shift**2))
    lasting, lag = 1.0, 1
    while lag < len(use) // 4:
        correlation = float(np.mean(shift[lag:] * shift[:-lag])) / variance
        if correlation < 4.0 / math.sqrt(n):
            break
        lasting += 2.0 * correlation
        lag += 1
    if lasting > 1.2:
        growth *= math.sqrt(lasting)
        why.append(
            f"gnss: the errors of successive fixes are alike, {lasting:.0f} count as one; sigmas were widened"
        )
    return growth, why


def review(graph: Graph, solution: Solution, state_t: Array, heading_known: bool) -> list[str]:
    """One line for each thing in a solved graph (with covariance) that a user should know."""
    said: list[str] = []
    if graph.positions is not None:
        item = graph.positions.linear(solution.poses, solution.constants)
        squares = np.einsum("ij,ij->i", item.residual, item.residual)
        out = graph.losses.position.weight(squares) < _OUT
        far = np.sqrt(squares) * graph.positions.sigma
        t = state_t[item.state]
        for first, last in stretches(out):
            count = np.count_nonzero(out[first : last + 1])
            said.append(
                f"gnss: {count} fixes from t = {t[first]:.1f} to {t[last]:.1f} s are off "
                f"by up to {far[first : last + 1].max():.1f} m; they count little or not at all"
            )
        if len(out) == 1:
            said.append("gnss: one fix only: it places the track, but does not tell its direction")
    item = graph.between.linear(solution.poses, solution.constants)
    slipped = graph.losses.between.weight(np.einsum("ij,ij->i", item.residual, item.residual)) < _OUT
    for first, last in stretches(slipped):
        said.append(
            f"odometry: between t = {state_t[first]:.1f} and {state_t[last + 1]:.1f} s it does not agree "
            "with what was measured from outside; slip or a carried vehicle"
        )
    blunt = math.sqrt(float(solution.covariance[0, 2, 2]))
    if blunt > _BLUNT_HEADING:
        cause = "nothing measures it" if not heading_known else "the fixes are too few or too close together"
        said.append(f"heading: known to {math.degrees(min(blunt, math.pi)):.0f} degrees only: {cause}")
    if not solution.converged:
        said.append(f"graph: not settled after {solution.iterations} steps; check the sigmas of the fixes")
    return said


def stretches(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last number of each stretch of flags that are set, gaps of up to two bridged."""
    places = np.flatnonzero(flags)
    if len(places) == 0:
        return []
    ends = np.flatnonzero(np.diff(places) > 3)
    firsts, lasts = np.append(0, ends + 1), np.append(ends, len(places) - 1)
    return [(int(places[a]), int(places[b])) for a, b in zip(firsts, lasts, strict=True)]
