"""Batch solution of odometry, GNSS fixes and headings for a whole drive (Shah et al. section IV)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hubodo.errors import InputError
from hubodo.fuse.graph.build import build_constants_prior, build_graph
from hubodo.fuse.graph.compass import assess_compass
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.exchanged_axes import check_exchanged_axes
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
"""s, 1 sigma of the fixes' delay during its search: latency of a receiver whose clock was set by hand."""
_DELAY_SIGNIFICANCE_SIGMAS = 3.5
"""Sigmas from which a delay is significant: by chance in one log of two thousand."""
_MIN_DELAY_RATIO = 3.0
"""Multiple of the configured sigma from which a delay is removed; the graph absorbs smaller ones."""
_MAX_DELAY = 10.0
"""s; a longer offset comes from another clock, or is no delay."""
_MAX_DELAY_ITERATIONS = 4
"""Times the fixes are shifted; each iteration leaves a tenth of the delay or less."""
_DELAY_TOLERANCE_SIGMAS = 0.2
"""Sigmas; a smaller remaining delay ends the search."""
_MIN_LOG_NOISE_CHANGE = 0.25
"""Change of the logarithm of the odometry's sigmas below which the graph is not solved again."""
_MAX_GROWTH_ITERATIONS, _MIN_GROWTH_RATIO = 3, 1.05
"""Iterations of sigma inflation, and the minimum factor of an iteration that is worth it."""


def fuse_graph(
    path: Track,
    fixes: Fixes | None,
    headings: Headings | None = None,
    config: GraphConfig | None = None,
    other_samples: Sequence[SensorSamples] = (),
) -> GraphResult:
    """Return the maximum a posteriori track of a whole drive.

    path: odometry with t, x, y and heading. other_samples: samples of further sensors. Raises InputError when
    there are fixes and none is usable, or the odometry has fewer than two poses.
    """
    check_odometry(path)
    config = config or GraphConfig()
    samples_of_drive = ([headings] if headings is not None else []) + list(other_samples)
    non_gnss_samples, config, compass_warnings = _assess_headings(path, samples_of_drive, fixes, config)
    local_fixes, scatter_growth, warnings = _prepare_fixes(path, fixes, config)
    warnings += compass_warnings
    search_config = config
    if config.estimate_delay:
        constants = replace(config.constants, gnss_delay=_DELAY_SEARCH_SIGMA)
        search_config = replace(config, constants=constants)
    drive = build_graph(path, _all_samples(local_fixes, non_gnss_samples), search_config)
    solution = solve_from_poor_guess(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    if config.inflate_sigmas and config.noise.relative_error == 0.0:
        config, drive, solution = _adapt_noise(
            path, _all_samples(local_fixes, non_gnss_samples), config, search_config, drive, solution
        )
        search_config = replace(search_config, noise=config.noise)

    uninflated_fixes, sigma_growth = local_fixes, 1.0
    growth_warnings: list[str] = []
    for _ in range(_MAX_GROWTH_ITERATIONS if config.inflate_sigmas else 0):
        growth, reasons = estimate_sigma_growth(drive.graph, solution, sigma_growth)
        if uninflated_fixes is None or growth < _MIN_GROWTH_RATIO * sigma_growth:
            break
        sigma_growth, growth_warnings = growth, reasons
        local_fixes = replace(uninflated_fixes, sigma=uninflated_fixes.sigma * sigma_growth)
        samples = _all_samples(local_fixes, non_gnss_samples)
        drive = build_graph(path, samples, search_config, solution)
        solution = solve_graph(drive.graph, solution.poses, solution.constants)
    warnings += growth_warnings
    shift = 0.0
    if config.estimate_delay and local_fixes is not None:
        shift, drive, solution = _estimate_delay(path, local_fixes, non_gnss_samples, config, drive, solution)
        if shift != 0.0:
            warnings.append(
                f"gnss: the positions belong to times {shift:+.2f} s from their time stamps; "
                "corrected here; check the receiver's clock and where its antenna is"
            )
    solution = solve_graph(drive.graph, solution.poses, solution.constants, "all")
    warnings += review_solution(drive.graph, solution, drive.odometry.pose_t, drive.heading_observable)
    map_frame = local_fixes.frame if local_fixes is not None else None
    return build_result(
        path, drive, solution, map_frame, scatter_growth * sigma_growth, config.noise, shift, tuple(warnings)
    )


def _assess_headings(
    path: Track, samples: Sequence[SensorSamples], fixes: Fixes | None, config: GraphConfig
) -> tuple[list[SensorSamples], GraphConfig, list[str]]:
    """Assess the headings of a compass; return all samples, settings adapted to them, and warnings.

    Without fixes, the track of a drive with a rejected compass starts at the odometry's heading.
    """
    used: list[SensorSamples] = []
    warnings: list[str] = []
    for sensor in samples:
        if not isinstance(sensor, Headings) or not config.inflate_sigmas:
            used.append(sensor)
            continue
        assessment = assess_compass(path, sensor, config)
        warnings += assessment.warnings
        config = replace(config, constants=assessment.constants)
        if assessment.headings is not None:
            used.append(assessment.headings)
        elif fixes is None and config.start_heading is None:
            config = replace(config, start_heading=float(path.heading[0]))
    return used, config, warnings


def _prepare_fixes(
    path: Track, fixes: Fixes | None, config: GraphConfig
) -> tuple[LocalFixes | None, float, list[str]]:
    """Return usable fixes in a local frame, the inflation of their sigmas by scatter, and warnings."""
    if fixes is None:
        return None, 1.0, []
    check_exchanged_axes(path, fixes)
    local_fixes = localise_fixes(fixes, path.t[0], path.t[-1], config.gnss_sigma, config.use_declared_sigmas)
    if not config.inflate_sigmas:
        return local_fixes, 1.0, list(local_fixes.warnings)
    screened, scatter_growth, warnings = screen_fixes(path, local_fixes)
    return screened, scatter_growth, [*local_fixes.warnings, *warnings]


def _all_samples(fixes: LocalFixes | None, other_samples: Sequence[SensorSamples]) -> list[SensorSamples]:
    """Return fixes and other samples as one list."""
    return [*([fixes] if fixes is not None else []), *other_samples]


def _adapt_noise(
    path: Track,
    samples: Sequence[SensorSamples],
    config: GraphConfig,
    search_config: GraphConfig,
    drive: DriveGraph,
    solution: Solution,
) -> tuple[GraphConfig, DriveGraph, Solution]:
    """Return settings, graph and solution with the odometry noise estimated from this drive's fixes.

    They are returned unchanged where the fixes agree with the configured noise.
    """
    factors = estimate_noise_factors(
        drive.graph, solution, drive.odometry.pose_t, config.constants.to_array()
    )
    if np.abs(np.log(factors)).max() < _MIN_LOG_NOISE_CHANGE:
        return config, drive, solution
    noise = replace(config.noise, sigma_factors=(float(factors[0]), float(factors[1]), float(factors[2])))
    adapted_config = replace(search_config, noise=noise)
    drive = build_graph(path, samples, adapted_config, solution, drive.heading_observable)
    return replace(config, noise=noise), drive, solve_graph(drive.graph, solution.poses, solution.constants)


def _estimate_delay(
    path: Track,
    fixes: LocalFixes,
    other_samples: Sequence[SensorSamples],
    config: GraphConfig,
    drive: DriveGraph,
    solution: Solution,
) -> tuple[float, DriveGraph, Solution]:
    """Return the offset of the fixes' time stamps, s, where it is significant, and the graph with it removed.

    Otherwise returns 0 with the graph in which the delay has its configured prior.
    """
    search_config = replace(config, constants=replace(config.constants, gnss_delay=_DELAY_SEARCH_SIGMA))
    unshifted = replace(drive, graph=_replace_prior(drive.graph, build_constants_prior(config))), solution
    shift = 0.0
    for _ in range(_MAX_DELAY_ITERATIONS):
        solution = solve_graph(drive.graph, solution.poses, solution.constants, "constants")
        step = float(solution.constants[GNSS_DELAY])
        sigma = math.sqrt(solution.constants_covariance[GNSS_DELAY, GNSS_DELAY])
        if shift == 0.0 and abs(step) < max(
            _DELAY_SIGNIFICANCE_SIGMAS * sigma, _MIN_DELAY_RATIO * config.constants.gnss_delay
        ):
            return 0.0, *unshifted
        shift += step
        if abs(shift) > _MAX_DELAY:
            return 0.0, *unshifted
        shifted_t = fixes.t + shift
        in_range = (shifted_t >= path.t[0]) & (shifted_t <= path.t[-1])
        if not in_range.any():
            raise InputError(
                "gnss: the fixes' clock differs from the odometry's by more than the drive lasts"
            )
        shifted_fixes = replace(fixes, t=shifted_t, warnings=()).select(in_range)
        drive = build_graph(path, _all_samples(shifted_fixes, other_samples), search_config)
        solution = solve_from_poor_guess(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS))
        if abs(solution.constants[GNSS_DELAY]) < _DELAY_TOLERANCE_SIGMAS * sigma:
            break
    unshifted_solution = solve_graph(unshifted[0].graph, unshifted[1].poses, unshifted[1].constants)
    if solution.cost > unshifted_solution.cost - 0.5 * _DELAY_SIGNIFICANCE_SIGMAS**2:
        return 0.0, *unshifted
    return shift, drive, solution


def _replace_prior(graph: FactorGraph, prior: ConstantsPriorFactors) -> FactorGraph:
    """Return the graph with a new prior of the constants."""
    return FactorGraph(
        tuple(prior if isinstance(factor, ConstantsPriorFactors) else factor for factor in graph.factors)
    )


__all__ = ["Fixes", "GraphConfig", "GraphResult", "Headings", "build_graph", "fuse_graph"]
