"""Odometry, GNSS fixes and headings to one track and the constants of the wheels (Shah et al. section IV)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.fuse.graph.alignment import align
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.between import BetweenFactors, Complex, whitening
from hubodo.fuse.graph.factors.constants import COUNT, DELAY, ConstantsFactor
from hubodo.fuse.graph.factors.heading import HeadingFactors
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.factors.start import StartFactor
from hubodo.fuse.graph.fixes import Fixes, Headings, LocalFixes, headings_at, usable_fixes
from hubodo.fuse.graph.review import error_growth, review, stretches
from hubodo.fuse.graph.screening import scatter, without_jumps
from hubodo.fuse.graph.solver import Graph, Solution, solve, solve_from_afar
from hubodo.fuse.graph.steps import CutPath, OdometryPath, cut_path
from hubodo.fuse.graph.track import GraphTrack, Problem, track_of

_WIDE_DELAY = 2.0
_PLAIN = 3.5
_LONGEST_DELAY = 10.0
_GROWTHS = 3
_FAR_OFF = 1e4


def fuse_graph(
    path: OdometryPath,
    fixes: Fixes | None,
    headings: Headings | None = None,
    config: GraphConfig | None = None,
) -> GraphTrack:
    """The most probable track of a whole drive.

    Raises InputError when there are fixes and none is usable, ConfigError when pyproj is missing.
    """
    config = config or GraphConfig()
    local = None
    if fixes is not None:
        local = usable_fixes(fixes, path.t[0], path.t[-1], config.gnss_sigma, config.declared)
    warnings = list(local.warnings) if local is not None else []
    grown = 1.0
    if local is not None and config.honest:
        local, grown, said = _screened(path, local)
        warnings += said
    widest = replace(config.constants, delay=_WIDE_DELAY) if config.search_delay else config.constants
    problem = build(path, local, headings, replace(config, constants=widest))
    solution = solve_from_afar(problem.graph, problem.poses, np.zeros(COUNT))

    told, wider = local, 1.0
    lasting: list[str] = []
    for _ in range(_GROWTHS if config.honest else 0):
        growth, why = error_growth(problem.graph, solution, wider)
        if told is None or growth < 1.05 * wider:
            break
        wider, lasting = growth, why
        local = replace(told, sigma=told.sigma * wider)
        problem = build(path, local, headings, replace(config, constants=widest), solution)
        solution = solve(problem.graph, solution.poses, solution.constants)
    warnings += lasting
    shift = 0.0
    if config.search_delay and local is not None:
        shift, problem, solution = _delay(path, local, headings, config, problem, solution)
        if shift != 0.0:
            warnings.append(
                f"gnss: the fixes name places {shift:+.2f} s from their time stamps; "
                "undone here; check the receiver's clock and where its antenna is"
            )
    solution = solve(problem.graph, solution.poses, solution.constants, "all")
    warnings += review(problem.graph, solution, problem.cut.state_t, problem.heading_known)
    frame = local.frame if local is not None else None
    return track_of(path, problem, solution, frame, grown * wider, shift, tuple(warnings))


def _screened(path: OdometryPath, local: LocalFixes) -> tuple[LocalFixes, float, list[str]]:
    """Fixes with sigmas that their scatter bears out and by what they grew, without those that jumped further
    than the wheels rolled; and what is to be said."""
    rolled = np.append(0.0, np.cumsum(np.hypot(np.diff(path.x), np.diff(path.y))))
    way = np.interp(local.t, path.t, rolled)
    said = []
    size = scatter(local.place, way, local.sigma)
    if size > 1.0:
        local = replace(local, sigma=local.sigma * size)
        said.append(f"gnss: the fixes scatter {size:.1f} times as much as their sigma says; it was widened")
    keep = without_jumps(local.place, way, local.sigma)
    for first, last in stretches(~keep):
        before = max(first - 1, 0) if first > 0 else last + 1
        jump = float(np.abs(local.place[first] - local.place[before]))
        said.append(
            f"gnss: {last - first + 1} fixes from t = {local.t[first]:.1f} to {local.t[last]:.1f} s "
            f"jumped, by {jump:.0f} m; left out"
        )
    kept = LocalFixes(
        local.row[keep], local.t[keep], local.place[keep], local.sigma[keep], local.frame, local.warnings
    )
    return kept, size, said


def build(
    path: OdometryPath,
    local: LocalFixes | None,
    headings: Headings | None,
    config: GraphConfig,
    solution: Solution | None = None,
) -> Problem:
    """The graph of a drive: a pose at each fix, at both ends, and where they would be further apart than
    `knot`.

    solution: of a graph with the same poses, in place of a first guess.
    """
    marks = local.t if local is not None else path.t[:0]
    cut = cut_path(path, _state_times(path.t[0], path.t[-1], marks, config.knot), config.noise)
    unwrapped = np.unwrap(path.heading)
    seen = None
    if headings is not None and len(headings.t) > 0:
        found = headings_at(headings, cut.state_t, path.t, unwrapped, config.heading_sigma)
        seen = HeadingFactors(*found) if len(found[0]) > 0 else None
    positions, poses, known = None, cut.pose.copy(), config.start_heading is not None
    turn = 0.0 if config.start_heading is None else config.start_heading - poses[0, 2]
    if not known and seen is not None:
        off = np.exp(1j * (seen.heading - poses[seen.state, 2]))
        turn, known = float(np.angle(off.sum())), True
    place = np.exp(1j * turn) * (poses[:, 0] + 1j * poses[:, 1])
    if local is not None:
        state = np.searchsorted(cut.state_t, local.t)
        positions = PositionFactors(
            state,
            np.column_stack([local.place.real, local.place.imag]),
            local.sigma,
            cut.velocity[state],
            config.antenna,
        )
        laid, place, by_fixes = _laid_on(local, cut, place)
        known = known or by_fixes
        poses[:, 2] += laid
    poses[:, 2] += turn
    poses[:, 0], poses[:, 1] = place.real, place.imag
    if solution is not None:
        poses = solution.poses
    start_sigma = np.array([_FAR_OFF, _FAR_OFF, math.pi / math.sqrt(3.0)])
    if local is None:
        start_sigma[:2] = 1e-3
    start = poses[0].copy()
    if config.start_heading is not None:
        start[2] = start[2] + math.remainder(config.start_heading - start[2], 2.0 * math.pi)
        start_sigma[2] = config.start_heading_sigma
    graph = Graph(
        BetweenFactors(cut.steps, whitening(cut.steps.covariance)),
        StartFactor(0, start, start_sigma),
        ConstantsFactor(np.zeros(COUNT), config.constants.array()),
        positions,
        seen,
        config.losses,
    )
    return Problem(graph, poses, cut, known)


def _laid_on(local: LocalFixes, cut: CutPath, place: Complex) -> tuple[Array, Complex, bool]:
    """How far each pose (n,) turns to lie on the fixes, where it is then, and whether the fixes told the
    turn."""
    at_fix = place[np.searchsorted(cut.state_t, local.t)]
    laid = align(at_fix, local.place, local.sigma)
    shift = laid.place - np.exp(1j * laid.heading) * at_fix
    turn = np.interp(cut.state_t, local.t, laid.heading)
    east, north = (np.interp(cut.state_t, local.t, part) for part in (shift.real, shift.imag))
    return turn, np.exp(1j * turn) * place + east + 1j * north, laid.found


def _state_times(begin: float, end: float, marks: Array, knot: float) -> Array:
    """Times of the poses: marks and both ends, and between them as many more as keep gaps below `knot`."""
    t = np.union1d(marks, np.array([begin, end]))
    gaps = np.diff(t)
    pieces = np.maximum(np.ceil(gaps / knot - 1e-9), 1.0).astype(np.intp)
    first = np.repeat(t[:-1], pieces)
    number = np.arange(len(first)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    return np.append(first + number * np.repeat(gaps / pieces, pieces), t[-1])


def _delay(
    path: OdometryPath,
    local: LocalFixes,
    headings: Headings | None,
    config: GraphConfig,
    problem: Problem,
    solution: Solution,
) -> tuple[float, Problem, Solution]:
    """The offset of the fixes' time stamps, in seconds, if they plainly show one, with the graph that has
    it undone; else 0 with the graph in which it is as small as configured."""
    wide = replace(config, constants=replace(config.constants, delay=_WIDE_DELAY))
    narrow = ConstantsFactor(np.zeros(COUNT), config.constants.array())
    without = replace(problem, graph=replace(problem.graph, constants=narrow)), solution
    shift = 0.0
    for _ in range(4):
        solution = solve(problem.graph, solution.poses, solution.constants, "constants")
        step = float(solution.constants[DELAY])
        sigma = math.sqrt(solution.constants_covariance[DELAY, DELAY])
        if shift == 0.0 and abs(step) < max(_PLAIN * sigma, 3.0 * config.constants.delay):
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
        later = LocalFixes(
            local.row[inside], moved[inside], local.place[inside], local.sigma[inside], local.frame, ()
        )
        problem = build(path, later, headings, wide)
        solution = solve_from_afar(problem.graph, problem.poses, np.zeros(COUNT))
        if abs(solution.constants[DELAY]) < 0.2 * sigma:
            break
    plain = solve(without[0].graph, without[1].poses, without[1].constants)
    if solution.cost > plain.cost - 0.5 * _PLAIN**2:
        return 0.0, *without
    return shift, problem, solution


__all__ = ["Fixes", "GraphConfig", "GraphTrack", "Headings", "OdometryPath", "build", "fuse_graph"]
