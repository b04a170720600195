"""Odometry, GNSS fixes and headings to one track and the constants of the wheels (Shah et al. section IV)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hubodo.errors import InputError
from hubodo.fuse.graph.build import build, prior_of
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factor_graph import Graph
from hubodo.fuse.graph.factors.constants import COUNT, GNSS_DELAY
from hubodo.fuse.graph.factors.factor import SensorSamples
from hubodo.fuse.graph.factors.heading import Headings
from hubodo.fuse.graph.factors.prior import ConstantsFactor
from hubodo.fuse.graph.fixes import Fixes, LocalFixes, screen_fixes, usable_fixes
from hubodo.fuse.graph.odometry_noise import odometry_noise
from hubodo.fuse.graph.review import error_growth, review
from hubodo.fuse.graph.solver import Solution, solve, solve_from_afar
from hubodo.fuse.graph.steps import check_odometry
from hubodo.fuse.graph.track import DriveGraph, GraphTrack, track_of
from hubodo.fuse.track import Track

_WIDE_DELAY = 2.0
"""s; 1 sigma of the fixes' delay while it is searched: a receiver's latency with a clock set by hand."""
_PLAIN = 3.5
"""Sigmas beyond which a delay is plainly there: by chance in one log of two thousand."""
_LARGE = 3.0
"""Times which a delay must exceed the configured sigma to be undone; less than that the graph takes up."""
_LONGEST_DELAY = 10.0
"""s; what looks longer is another clock, or no delay."""
_ROUNDS = 4
"""Times the fixes are moved: each leaves a tenth of a delay or less."""
_SETTLED = 0.2
"""Sigmas; a delay that is left below this is found."""
_SAME_NOISE = 0.25
"""Of the odometry's sigmas: a graph whose noise differs by less is as good."""
_GROWTHS, _GROWN = 3, 1.05
"""Rounds of widening sigmas, and how much a round must widen them to be worth it."""


def fuse_graph(
    path: Track,
    fixes: Fixes | None,
    headings: Headings | None = None,
    config: GraphConfig | None = None,
    others: Sequence[SensorSamples] = (),
) -> GraphTrack:
    """The most probable track of a whole drive.

    others: whatever else was measured. Raises InputError when there are fixes and none is usable.
    """
    check_odometry(path)
    config = config or GraphConfig()
    beside = ([headings] if headings is not None else []) + list(others)
    local = None
    if fixes is not None:
        local = usable_fixes(fixes, path.t[0], path.t[-1], config.gnss_sigma, config.declared)
    warnings = list(local.warnings) if local is not None else []
    grown = 1.0
    if local is not None and config.honest:
        local, grown, said = screen_fixes(path, local)
        warnings += said
    widest = replace(config.constants, gnss_delay=_WIDE_DELAY) if config.search_delay else config.constants
    wide = replace(config, constants=widest)
    drive = build(path, _all(local, beside), wide)
    solution = solve_from_afar(drive.graph, drive.poses, np.zeros(COUNT))
    if config.honest and config.noise.share == 0.0:
        config, drive, solution = _with_own_noise(path, _all(local, beside), config, wide, drive, solution)
        wide = replace(wide, noise=config.noise)

    told, wider = local, 1.0
    lasting: list[str] = []
    for _ in range(_GROWTHS if config.honest else 0):
        growth, why = error_growth(drive.graph, solution, wider)
        if told is None or growth < _GROWN * wider:
            break
        wider, lasting = growth, why
        local = replace(told, sigma=told.sigma * wider)
        drive = build(path, _all(local, beside), wide, solution)
        solution = solve(drive.graph, solution.poses, solution.constants)
    warnings += lasting
    shift = 0.0
    if config.search_delay and local is not None:
        shift, drive, solution = _delay(path, local, beside, config, drive, solution)
        if shift != 0.0:
            warnings.append(
                f"gnss: the fixes name places {shift:+.2f} s from their time stamps; "
                "undone here; check the receiver's clock and where its antenna is"
            )
    solution = solve(drive.graph, solution.poses, solution.constants, "all")
    warnings += review(drive.graph, solution, drive.cut.state_t, drive.heading_known)
    frame = local.frame if local is not None else None
    return track_of(path, drive, solution, frame, grown * wider, config.noise, shift, tuple(warnings))


def _all(local: LocalFixes | None, beside: Sequence[SensorSamples]) -> list[SensorSamples]:
    return [*([local] if local is not None else []), *beside]


def _with_own_noise(
    path: Track,
    measured: Sequence[SensorSamples],
    config: GraphConfig,
    wide: GraphConfig,
    drive: DriveGraph,
    solution: Solution,
) -> tuple[GraphConfig, DriveGraph, Solution]:
    """Settings, graph and solution with the noise that this drive's odometry shows, where it shows any."""
    times = odometry_noise(drive.graph, solution, drive.cut.state_t, config.constants.array())
    if np.abs(np.log(times)).max() < _SAME_NOISE:
        return config, drive, solution
    noise = replace(config.noise, times=(float(times[0]), float(times[1]), float(times[2])))
    drive = build(path, measured, replace(wide, noise=noise), solution)
    return replace(config, noise=noise), drive, solve(drive.graph, solution.poses, solution.constants)


def _delay(
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
    wide = replace(config, constants=replace(config.constants, gnss_delay=_WIDE_DELAY))
    without = replace(drive, graph=_with_prior(drive.graph, prior_of(config))), solution
    shift = 0.0
    for _ in range(_ROUNDS):
        solution = solve(drive.graph, solution.poses, solution.constants, "constants")
        step = float(solution.constants[GNSS_DELAY])
        sigma = math.sqrt(solution.constants_covariance[GNSS_DELAY, GNSS_DELAY])
        if shift == 0.0 and abs(step) < max(_PLAIN * sigma, _LARGE * config.constants.gnss_delay):
            return 0.0, *without
        shift += step
        if abs(shift) > _LONGEST_DELAY:
            return 0.0, *without
        moved = local.t + shift
        inside = (moved >= path.t[0]) & (moved <= path.t[-1])
        if not inside.any():
            raise InputError(
                "gnss: the fixes' clock differs from the odometry's by more than the drive lasts"
            )
        later = replace(local, t=moved, warnings=()).chosen(inside)
        drive = build(path, _all(later, beside), wide)
        solution = solve_from_afar(drive.graph, drive.poses, np.zeros(COUNT))
        if abs(solution.constants[GNSS_DELAY]) < _SETTLED * sigma:
            break
    plain = solve(without[0].graph, without[1].poses, without[1].constants)
    if solution.cost > plain.cost - 0.5 * _PLAIN**2:
        return 0.0, *without
    return shift, drive, solution


def _with_prior(graph: Graph, prior: ConstantsFactor) -> Graph:
    return Graph(tuple(prior if isinstance(factor, ConstantsFactor) else factor for factor in graph.factors))


__all__ = ["Fixes", "GraphConfig", "GraphTrack", "Headings", "build", "fuse_graph"]
