"""Assessment of a compass against the odometry: deviation by iron, sigma of its headings, or rejection."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.graph.build import build_graph
from hubodo.fuse.graph.compass_noise import low_frequency_sigma
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.disturbed_field import DisturbedSpan, find_disturbed_span
from hubodo.fuse.graph.factors.between import BetweenFactors
from hubodo.fuse.graph.factors.constants import COMPASS_IRON, N_CONSTANTS, ConstantSigmas
from hubodo.fuse.graph.factors.heading import HEADING_LOSS, HeadingFactors, Headings
from hubodo.fuse.graph.result import DriveGraph
from hubodo.fuse.graph.review import MIN_USED_WEIGHT
from hubodo.fuse.graph.solver import Solution, solve_from_poor_guess, solve_graph
from hubodo.fuse.track import Track

_HARD_IRON_SIGMA, _SOFT_IRON_SIGMA = 0.4, 0.1
"""Fractions of the horizontal field, prior 1 sigma of an uncompensated compass on a steel vehicle."""
_COMPENSATED_IRON_SIGMA = 0.03
"""Fraction of the horizontal field, prior 1 sigma of a compensated compass: 1.7 deg."""
_MIN_COMPASS_SIGMA, _NO_IRON_SIGMA = 0.015, 1e-3
"""rad and fraction: headings with a smaller sigma are those of two antennas, which iron does not disturb."""
_OFFSET_SIGMA = 0.5
"""rad, of the offset beside a known start heading: declination, and a compass mounted askew."""
_MIN_LOG_EVIDENCE = 0.0
"""Logarithm of the Bayes factor from which iron is assumed."""
_MAX_ITERATIONS, _MIN_GROWTH_RATIO = 4, 1.05
"""Iterations of the sigma's inflation, and the least factor of an iteration that is worth it."""
_MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
_DISTURBED_MARGIN = 3.0
"""s before and after an outlier, left out as well: the field of iron beside the road grows gradually."""
_MAX_DISTURBED_SPANS = 3
"""Spans of a disturbed field that are left out; more are many short ones, left to the robust loss."""
_MAX_DISTURBED_SHARE = 0.42
"""Share of the headings of one span, or of all left out, above which nothing says which part is disturbed."""
_MIN_HEADINGS = 10
"""Poses with a heading; fewer do not show iron or their own scatter."""
_MIN_USED_SHARE = 0.5
"""Share of headings within three sigma of the solution below which the compass is rejected."""
_MAX_SCATTER = 0.35
"""rad; a scatter beyond 20 degrees carries no heading that gyros do not know better."""
_MAX_IRON = 0.9
"""Fraction of the horizontal field beyond which a compass hardly turns with the vehicle."""
_MAX_ODOMETRY_COST = 30.0
"""Squared sigmas by which headings may change odometry and constants: one drive of 1e4 has more by chance."""
_IRON_REPORT_SIGMAS = 3.0
"""Sigmas from which the estimated iron is reported."""


@dataclass(frozen=True, eq=False)
class CompassAssessment:
    """The assessment of a compass by the turns of its drive.

    Attributes
    ----------
    headings : headings with sigmas that cover their scatter and correlation; None if the compass is rejected.
    constants : prior sigmas of the constants; those of iron and offset are adapted to the drive.
    warnings : one line each.
    """

    headings: Headings | None
    constants: ConstantSigmas
    warnings: tuple[str, ...]


def assess_compass(path: Track, headings: Headings, config: GraphConfig) -> CompassAssessment:
    """Assess the headings of a compass against the turns that the odometry measured.

    The heading of the gyros drifts slowly. Over a drive with turns it separates the deviation by the
    vehicle's iron, which depends on the heading, from disturbances beside the road, which depend on the
    place.
    """
    headings = replace(headings, sigma=_declared_sigma(headings, config))
    if not len(headings.t):
        return CompassAssessment(headings, config.constants, ())
    is_compass = float(np.median(np.asarray(headings.sigma))) > _MIN_COMPASS_SIGMA
    remaining = _COMPENSATED_IRON_SIGMA if is_compass else _NO_IRON_SIGMA
    narrow = _with_iron(config.constants, remaining, remaining)
    wide = _with_iron(config.constants, _HARD_IRON_SIGMA, _SOFT_IRON_SIGMA)
    if config.start_heading is not None:
        wide = replace(wide, compass_offset=_OFFSET_SIGMA)
    spans: list[DisturbedSpan] = []
    while True:
        widened, drive, solution, residual = _widen_to_scatter(
            path, headings, replace(config, constants=wide)
        )
        if len(residual) < _MIN_HEADINGS:
            return CompassAssessment(headings, narrow, ())
        span = find_disturbed_span(drive, solution, replace(config, constants=wide))
        if span is None or len(spans) == _MAX_DISTURBED_SPANS:
            break
        spans.append(span)
        headings = _drop_span(headings, span)
    reason = _find_ambiguity(spans) or _find_contradiction(drive, solution, wide)
    if reason:
        return CompassAssessment(None, config.constants, (f"compass: {reason}; its headings are not used",))
    factors = drive.graph.find_group(HeadingFactors)
    assert factors is not None
    outliers = factors.pose_index[~_is_used(residual)]
    undisturbed = _drop_disturbed(widened, drive.odometry.pose_t[outliers])
    noise = low_frequency_sigma(drive, solution, replace(config, constants=wide), _is_used(residual))
    growth = max(1.0, noise / float(np.median(factors.sigma)))
    grown = replace(undisturbed, sigma=np.asarray(undisturbed.sigma) * growth)
    drive, solution, _ = _solve(path, grown, replace(config, constants=wide))
    solution = solve_graph(drive.graph, solution.poses, solution.constants, "constants")
    disturbed = _describe_spans(spans)
    if _log_evidence_of_iron(solution, narrow, wide) < _MIN_LOG_EVIDENCE:
        return CompassAssessment(grown, narrow, disturbed)
    return CompassAssessment(grown, wide, (*_describe_iron(solution), *disturbed))


def _with_iron(constants: ConstantSigmas, hard: float, soft: float) -> ConstantSigmas:
    """Return the prior sigmas with those of hard and soft iron, fractions of the horizontal field, set."""
    return replace(
        constants,
        compass_hard_iron_forward=hard,
        compass_hard_iron_left=hard,
        compass_soft_iron_forward=soft,
        compass_soft_iron_diagonal=soft,
    )


def _declared_sigma(headings: Headings, config: GraphConfig) -> Array:
    """Return the sigma of each heading, rad: as declared, else that of the settings."""
    declared = np.full(len(headings.t), np.nan) if headings.sigma is None else np.asarray(headings.sigma)
    return np.where(np.isfinite(declared) & (declared > 0.0), declared, config.heading_sigma)


def _solve(path: Track, headings: Headings, config: GraphConfig) -> tuple[DriveGraph, Solution, Array]:
    """Return graph and solution of odometry and headings, and the residual of each heading, in sigma."""
    drive = build_graph(path, [headings], config)
    solution = solve_from_poor_guess(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    factors = drive.graph.find_group(HeadingFactors)
    if factors is None:
        return drive, solution, np.zeros(0)
    return drive, solution, factors.linearise(solution.poses, solution.constants).residual[:, 0]


def _is_used(residual: Array) -> NDArray[np.bool_]:
    """Return a flag that is set for each residual, in sigma, to which the robust loss gives enough weight."""
    return np.asarray(HEADING_LOSS.weight(residual**2) > MIN_USED_WEIGHT)


def _widen_to_scatter(
    path: Track, headings: Headings, config: GraphConfig
) -> tuple[Headings, DriveGraph, Solution, Array]:
    """Return headings with sigmas that cover their scatter, with graph, solution and residuals."""
    for _ in range(_MAX_ITERATIONS):
        drive, solution, residual = _solve(path, headings, config)
        scatter = _MAD_TO_SIGMA * float(np.median(np.abs(residual))) if len(residual) else 1.0
        if scatter < _MIN_GROWTH_RATIO:
            break
        headings = replace(headings, sigma=np.asarray(headings.sigma) * scatter)
    return headings, drive, solution, residual


def _drop_disturbed(headings: Headings, disturbed_t: Array) -> Headings:
    """Return the headings further than `_DISTURBED_MARGIN` from times at which they were outliers."""
    if not len(disturbed_t):
        return headings
    after = np.clip(np.searchsorted(disturbed_t, headings.t), 0, len(disturbed_t) - 1)
    before = np.maximum(after - 1, 0)
    distance = np.minimum(np.abs(disturbed_t[after] - headings.t), np.abs(disturbed_t[before] - headings.t))
    keep = distance > _DISTURBED_MARGIN
    return Headings(headings.t[keep], headings.heading[keep], np.asarray(headings.sigma)[keep])


def _drop_span(headings: Headings, span: DisturbedSpan) -> Headings:
    """Return the headings outside a span, or those inside where it holds the larger part of the drive."""
    margin = _DISTURBED_MARGIN
    if span.share <= 0.5:
        keep = (headings.t < span.start - margin) | (headings.t > span.end + margin)
    else:
        keep = (headings.t > span.start + margin) & (headings.t < span.end - margin)
    return Headings(headings.t[keep], headings.heading[keep], np.asarray(headings.sigma)[keep])


def _find_ambiguity(spans: Sequence[DisturbedSpan]) -> str:
    """Return the reason why the disturbed headings cannot be identified, or an empty text."""
    undisturbed_share = 1.0
    for span in spans:
        share = min(span.share, 1.0 - span.share)
        undisturbed_share *= 1.0 - share
        if share > _MAX_DISTURBED_SHARE or 1.0 - undisturbed_share > _MAX_DISTURBED_SHARE:
            return (
                f"its headings from {span.start:.0f} to {span.end:.0f} s contradict the others, and nothing "
                "says which of them a field beside the road has turned"
            )
    return ""


def _describe_spans(spans: Sequence[DisturbedSpan]) -> tuple[str, ...]:
    """Return a line on the spans of a disturbed field."""
    times = (
        f"{s.start:.0f} to {s.end:.0f} s" if s.share <= 0.5 else f"outside {s.start:.0f} to {s.end:.0f} s"
        for s in spans
    )
    if not spans:
        return ()
    return (f"compass: a field beside the road turned the headings, {', '.join(times)}; they are left out",)


def _find_contradiction(drive: DriveGraph, solution: Solution, sigmas: ConstantSigmas) -> str:
    """Return why the headings cannot be those of a compass on this drive, or an empty text."""
    factors = drive.graph.find_group(HeadingFactors)
    assert factors is not None
    residual = factors.linearise(solution.poses, solution.constants).residual[:, 0]
    used = _is_used(residual)
    if np.mean(used) < _MIN_USED_SHARE:
        return f"{np.mean(~used):.0%} of its headings contradict the gyros, with any iron"
    scatter = float(np.sqrt(np.mean((residual * factors.sigma)[used] ** 2)))
    if scatter > _MAX_SCATTER:
        return f"its headings scatter by {math.degrees(scatter):.0f}° about the gyros', with any iron"
    hard, soft = _iron_sizes(solution)
    if hard + soft > _MAX_IRON:
        return f"the field of the vehicle's iron would be {hard + soft:.0%} of that of the Earth"
    between = drive.graph.find_group(BetweenFactors)
    assert between is not None
    normalised = solution.constants / sigmas.to_array()
    cost = float(between.linearise(solution.poses, solution.constants).squared_norms.sum())
    cost += float(np.sum(normalised[: COMPASS_IRON.start - 1] ** 2))
    if cost > _MAX_ODOMETRY_COST:
        return f"its headings turn differently from the gyros, by {math.sqrt(cost):.0f} sigma"
    return ""


def _log_evidence_of_iron(solution: Solution, narrow: ConstantSigmas, wide: ConstantSigmas) -> float:
    """Return the logarithm of the Bayes factor of iron that was not compensated against compensated iron.

    solution: with the wide prior. Likelihood and priors of the iron are normal, so both marginal likelihoods
    have a closed form.
    """
    estimate, covariance = (
        solution.constants[COMPASS_IRON],
        solution.constants_covariance[COMPASS_IRON, COMPASS_IRON],
    )
    wide_variance, narrow_variance = (
        np.diag(sigmas.to_array()[COMPASS_IRON] ** 2) for sigmas in (wide, narrow)
    )
    # The likelihood alone: the prior is divided out of the posterior.
    information = np.linalg.inv(covariance) - np.linalg.inv(wide_variance)
    vector = np.linalg.inv(covariance) @ estimate

    def log_marginal(p: Array) -> float:
        total = information + np.linalg.inv(p)
        return 0.5 * float(vector @ np.linalg.solve(total, vector) - np.linalg.slogdet(p @ total)[1])

    return log_marginal(wide_variance) - log_marginal(narrow_variance)


def _iron_sizes(solution: Solution) -> tuple[float, float]:
    """Return the size of hard and of soft iron, fractions of the horizontal field."""
    forward, left, along, diagonal = solution.constants[COMPASS_IRON]
    return math.hypot(forward, left), math.hypot(along, diagonal)


def _describe_iron(solution: Solution) -> tuple[str, ...]:
    """Return a line on the estimated iron where it is significant."""
    iron = solution.constants[COMPASS_IRON]
    sigma = np.sqrt(np.diag(solution.constants_covariance)[COMPASS_IRON])
    if not np.any(np.abs(iron) > _IRON_REPORT_SIGMAS * sigma):
        return ()
    hard, soft = _iron_sizes(solution)
    return (
        f"compass: iron of the vehicle, {hard:.0%} of the field (hard) and {soft:.0%} (soft), was estimated "
        "beside the gyros and corrected; compensate the compass",
    )
