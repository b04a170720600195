"""Odometry, GNSS fixes and headings to one track and the constants of the wheels (Shah et al. section IV)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hubodo.errors import InputError
from hubodo.fuse.graph.build import build_constants_prior, build_graph
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.constants import GNSS_DELAY, N_CONSTANTS
from hubodo.fuse.graph.factors.factor import SensorSamples
from hubodo.fuse.graph.factors.heading import Headings
from hubodo.fuse.graph.factors.prior import ConstantsPriorFactors
from hubodo.fuse.graph.fixes import Fixes, LocalFixes, localise_fixes, screen_fixes
from hubodo.fuse.graph.odometry_noise import estimate_noise_factors
from hubodo.fuse.graph.odometry_steps import check_odometry
from hubodo.fuse.graph.result import DriveGraph, GraphResult, build_result
from hubodo.fuse.graph.review import estimate_sigma_growth, review_solution
from hubodo.fuse.graph.solver import Solution, solve_from_poor_guess, solve_graph
from hubodo.fuse.track import Track

_DELAY_SEARCH_SIGMA = 2.0
"""s; 1 sigma of the fixes' delay while it is searched: a receiver's latency with a clock set by hand."""
_DELAY_SIGNIFICANCE_SIGMAS = 3.5
"""Sigmas beyond which a delay is plainly there: by chance in one log of two thousand."""
_MIN_DELAY_RATIO = 3.0
"""Times which a delay must exceed the configured sigma to be undone; less than that the graph takes up."""
_MAX_DELAY = 10.0
"""s; what looks longer is another clock, or no delay."""
_MAX_DELAY_ITERATIONS = 4
"""Times the fixes are moved: each leaves a tenth of a delay or less."""
_DELAY_TOLERANCE_SIGMAS = 0.2
"""Sigmas; a delay that is left below this is found."""
_MIN_LOG_NOISE_CHANGE = 0.25
"""Of the odometry's sigmas: a graph whose noise differs by less is as good."""
_MAX_GROWTH_ITERATIONS, _MIN_GROWTH_RATIO = 3, 1.05
"""Rounds of widening sigmas, and how much a round must widen them to be worth it."""


def fuse_graph(
    path: Track,
    fixes: Fixes | None,
    headings: Headings | None = None,
    config: GraphConfig | None = None,
    other_samples: Sequence[SensorSamples] = (),
) -> GraphResult:
    """The most probable track of a whole drive.

    others: whatever else was measured. Raises InputError when there are fixes and none is usable.
    """
    check_odometry(path)
    config = config or GraphConfig()
    beside = ([headings] if headings is not None else []) + list(other_samples)
    local = None
    if fixes is not None:
        local = localise_fixes(fixes, path.t[0], path.t[-1], config.gnss_sigma, config.use_declared_sigmas)
    warnings = list(local.warnings) if local is not None else []
    grown = 1.0
    if local is not None and config.inflate_sigmas:
        local, grown, said = screen_fixes(path, local)
        warnings += said
    widest = (
        replace(config.constants, gnss_delay=_DELAY_SEARCH_SIGMA)
        if config.estimate_delay
        else config.constants
    )
    wide = replace(config, constants=widest)
    drive = build_graph(path, _all_samples(local, beside), wide)
    solution = solve_from_poor_guess(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    if config.inflate_sigmas and config.noise.relative_error == 0.0:
        config, drive, solution = _adapt_noise(
            path, _all_samples(local, beside), config, wide, drive, solution
        )
        wide = replace(wide, noise=config.noise)

    told, wider = local, 1.0
    lasting: list[str] = []
    for _ in range(_MAX_GROWTH_ITERATIONS if config.inflate_sigmas else 0):
        growth, why = estimate_sigma_growth(drive.graph, solution, wider)
        if told is None or growth < _MIN_GROWTH_RATIO * wider:
            break
        wider, lasting = growth, why
        local = replace(told, sigma=told.sigma * wider)
        drive = build_graph(path, _all_samples(local, beside), wide, solution)
        solution = solve_graph(drive.graph, solution.poses, solution.constants)
    warnings += lasting
    shift = 0.0
    if config.estimate_delay and local is not None:
        shift, drive, solution = _estimate_delay(path, local, beside, config, drive, solution)
        if shift != 0.0:
            warnings.append(
                f"gnss: the fixes name places {shift:+.2f} s from their time stamps; "
                "undone here; check the receiver's clock and where its antenna is"
            )
    solution = solve_graph(drive.graph, solution.poses, solution.constants, "all")
    warnings += review_solution(drive.graph, solution, drive.odometry.pose_t, drive.heading_observable)
    frame = local.frame if local is not None else None
    return build_result(path, drive, solution, frame, grown * wider, config.noise, shift, tuple(warnings))


def _all_samples(local: LocalFixes | None, beside: Sequence[SensorSamples]) -> list[SensorSamples]:
    return [*([local] if local is not None else []), *beside]


def _adapt_noise(
    path: Track,
    measured: Sequence[SensorSamples],
    config: GraphConfig,
    wide: GraphConfig,
    drive: DriveGraph,
    solution: Solution,
) -> tuple[GraphConfig, DriveGraph, Solution]:
    """Settings, graph and solution with the noise that this drive's odometry shows, where it shows any."""
    times = estimate_noise_factors(drive.graph, solution, drive.odometry.pose_t, config.constants.to_array())
    if np.abs(np.log(times)).max() < _MIN_LOG_NOISE_CHANGE:
        return config, drive, solution
    noise = replace(config.noise, sigma_factors=(float(times[0]), float(times[1]), float(times[2])))
    drive = build_graph(path, measured, replace(wide, noise=noise), solution)
    return replace(config, noise=noise), drive, solve_graph(drive.graph, solution.poses, solution.constants)


def _estimate_delay(
    path: Track,
    local: LocalFixes,
    beside: Sequence[SensorSamples],
    config: GraphConfig,
    drive: DriveGraph,
    solution: Solution,
) -> tuple[float, DriveGraph, Solution]:
    """The offset of the fixes' time stamps, in seconds, if they plainly show one.

    With it comes the graph that has it undone; else 0 with the graph in which it is as small as configured.
    """
    wide = replace(config, constants=replace(config.constants, gnss_delay=_DELAY_SEARCH_SIGMA))
    without = replace(drive, graph=_replace_prior(drive.graph, build_constants_prior(config))), solution
    shift = 0.0
    for _ in range(_MAX_DELAY_ITERATIONS):
        solution = solve_graph(drive.graph, solution.poses, solution.constants, "constants")
        step = float(solution.constants[GNSS_DELAY])
        sigma = math.sqrt(solution.constants_covariance[GNSS_DELAY, GNSS_DELAY])
        if shift == 0.0 and abs(step) < max(
            _DELAY_SIGNIFICANCE_SIGMAS * sigma, _MIN_DELAY_RATIO * config.constants.gnss_delay
        ):
            return 0.0, *without
        shift += step
        if abs(shift) > _MAX_DELAY:
            return 0.0, *without
        moved = local.t + shift
        inside = (moved >= path.t[0]) & (moved <= path.t[-1])
        if not inside.any():
            raise InputError(
                "gnss: the fixes' clock differs from the odometry's by more than the drive lasts"
            )
        later = replace(local, t=moved, warnings=()).select(inside)
        drive = build_graph(path, _all_samples(later, beside), wide)
        solution = solve_from_poor_guess(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS))
        if abs(solution.constants[GNSS_DELAY]) < _DELAY_TOLERANCE_SIGMAS * sigma:
            break
    plain = solve_graph(without[0].graph, without[1].poses, without[1].constants)
    if solution.cost > plain.cost - 0.5 * _DELAY_SIGNIFICANCE_SIGMAS**2:
        return 0.0, *without
    return shift, drive, solution


def _replace_prior(graph: FactorGraph, prior: ConstantsPriorFactors) -> FactorGraph:
    return FactorGraph(
        tuple(prior if isinstance(factor, ConstantsPriorFactors) else factor for factor in graph.factors)
    )


__all__ = ["Fixes", "GraphConfig", "GraphResult", "Headings", "build_graph", "fuse_graph"]
