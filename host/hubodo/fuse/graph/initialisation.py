"""Start of a live graph: a batch solution over the last measurements, once it determines the heading."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hubodo.fuse.graph.batch import fuse_graph
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.factor import SensorSamples, concatenate_samples
from hubodo.fuse.graph.fixes import Fixes, localise_fixes
from hubodo.fuse.graph.odometry_steps import StepNoise
from hubodo.fuse.graph.window import PoseWindow
from hubodo.fuse.projection import LocalFrame
from hubodo.fuse.track import Track

_MIN_FIXES_TO_START = 3
"""Two fixes determine rotation and shift, the third checks them."""
_MAX_SIGMA_RATIO_TO_START = 2.0
"""Times the required sigma; where the fixes cannot determine the heading that well no batch is solved."""


@dataclass(slots=True)
class RunningGraph:
    """A live graph that has started.

    Attributes
    ----------
    window : the newest poses with their factors and solution.
    frame : map frame of the poses.
    sigma_growth : factor by which the sigmas of fixes are inflated.
    noise : noise of the odometry.
    last_fix_t : s, time of the newest fix that was used.
    warnings : one line each, of the start.
    """

    window: PoseWindow
    frame: LocalFrame
    sigma_growth: float
    noise: StepNoise
    last_fix_t: float
    warnings: tuple[str, ...]


def start_graph(
    path: Track,
    samples: Sequence[Fixes | SensorSamples],
    config: GraphConfig,
    heading_sigma: float,
) -> RunningGraph | None:
    """Return a window over the whole path and the samples measured along it.

    Returns None while there are too few fixes, or the newest heading is not known to heading_sigma, rad.
    samples: one measurement each, by time. Raises InputError when there are fixes and none is usable.
    """
    fixes = [sample for sample in samples if isinstance(sample, Fixes)]
    if len(fixes) < _MIN_FIXES_TO_START:
        return None
    kinds: dict[type[SensorSamples], list[SensorSamples]] = {}
    for sample in samples:
        if not isinstance(sample, Fixes):
            kinds.setdefault(type(sample), []).append(sample)
    other_samples = [concatenate_samples(of_one_kind) for of_one_kind in kinds.values()]
    ordered_fixes = _drop_late_fixes(concatenate_samples(fixes))
    only_fixes = not other_samples and config.start_heading is None
    if (
        only_fixes
        and _bound_heading_information(path, ordered_fixes, config)
        < (_MAX_SIGMA_RATIO_TO_START * heading_sigma) ** -2.0
    ):
        return None
    # A live window cannot shift fixes in time, so their delay must be small.
    config = replace(config, estimate_delay=False)
    batch = fuse_graph(path, ordered_fixes, None, config, other_samples)
    solution = batch.solution
    if batch.frame is None or math.sqrt(float(solution.covariance[-1, 2, 2])) > heading_sigma:
        return None
    window = PoseWindow(
        batch.graph,
        batch.pose_t,
        solution.poses,
        solution.constants,
        solution.covariance[-1],
        solution.constants_covariance,
    )
    last_fix_t = float(batch.fix_t[-1])
    return RunningGraph(window, batch.frame, batch.sigma_growth, batch.noise, last_fix_t, batch.warnings)


def _bound_heading_information(path: Track, fixes: Fixes, config: GraphConfig) -> float:
    """Return an upper bound, 1/rad², of the information on the heading in fixes.

    It is that of their lever arms if the shape of the path were known exactly.
    """
    local = localise_fixes(fixes, path.t[0], path.t[-1], config.gnss_sigma, config.use_declared_sigmas)
    if not len(local.t):
        return math.inf  # the batch solution raises the error with its reason
    x, y, heading = (np.interp(local.t, path.t, v) for v in (path.x, path.y, np.unwrap(path.heading)))
    position = x + 1j * y + np.exp(1j * heading) * complex(*config.antenna)
    information = local.sigma**-2.0
    return float(np.sum(information * np.abs(position - np.average(position, weights=information)) ** 2))


def _drop_late_fixes(fixes: Fixes) -> Fixes:
    """Return the fixes that are later than all fixes before them in the record."""
    keep = fixes.t > np.append(-np.inf, np.maximum.accumulate(fixes.t)[:-1])
    assert fixes.sigma is not None
    return Fixes(fixes.t[keep], fixes.latitude_deg[keep], fixes.longitude_deg[keep], fixes.sigma[keep])
