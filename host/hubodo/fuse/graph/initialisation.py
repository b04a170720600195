"""Where the live graph begins: a batch solution over the last measurements, once it tells the heading."""

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
"""Fixes from which a start is worth trying: two tell a turn and shift, the third whether it is true."""
_MAX_SIGMA_RATIO_TO_START = 2.0
"""Times the sigma that is wanted: where the fixes cannot tell the heading that well no batch is solved."""


@dataclass(slots=True)
class RunningGraph:
    """A live graph that has begun.

    growth: times which the fixes' sigma is widened; noise: of the odometry; fix_t: s of the newest fix that
    counted; warnings: what
    the start had to say.
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
    """The window over a whole path and what was measured on it.

    None while there is too little, or the newest heading is not known to heading_sigma, rad. samples: one
    each, by time. Raises InputError when there are fixes and none is usable.
    """
    fixes = [sample for sample in samples if isinstance(sample, Fixes)]
    if len(fixes) < _MIN_FIXES_TO_START:
        return None
    kinds: dict[type[SensorSamples], list[SensorSamples]] = {}
    for sample in samples:
        if not isinstance(sample, Fixes):
            kinds.setdefault(type(sample), []).append(sample)
    others = [concatenate_samples(own) for own in kinds.values()]
    told = _drop_late_fixes(concatenate_samples(fixes))
    alone = not others and config.start_heading is None
    if (
        alone
        and _bound_heading_information(path, told, config)
        < (_MAX_SIGMA_RATIO_TO_START * heading_sigma) ** -2.0
    ):
        return None
    # A window cannot move fixes in time, so what delay they have must stay small.
    config = replace(config, estimate_delay=False)
    batch = fuse_graph(path, told, None, config, others)
    found = batch.solution
    if batch.frame is None or math.sqrt(float(found.covariance[-1, 2, 2])) > heading_sigma:
        return None
    window = PoseWindow(
        batch.graph,
        batch.pose_t,
        found.poses,
        found.constants,
        found.covariance[-1],
        found.constants_covariance,
    )
    newest = float(batch.fix_t[-1])
    return RunningGraph(window, batch.frame, batch.sigma_growth, batch.noise, newest, batch.warnings)


def _bound_heading_information(path: Track, fixes: Fixes, config: GraphConfig) -> float:
    """1 / rad² of the heading in fixes, at most: that of their lever arms, were the path's shape certain."""
    local = localise_fixes(fixes, path.t[0], path.t[-1], config.gnss_sigma, config.use_declared_sigmas)
    if not len(local.t):
        return math.inf  # the batch says why
    x, y, heading = (np.interp(local.t, path.t, v) for v in (path.x, path.y, np.unwrap(path.heading)))
    place = x + 1j * y + np.exp(1j * heading) * complex(*config.antenna)
    share = local.sigma**-2.0
    return float(np.sum(share * np.abs(place - np.average(place, weights=share)) ** 2))


def _drop_late_fixes(fixes: Fixes) -> Fixes:
    """Those whose time exceeds all before."""
    keep = fixes.t > np.append(-np.inf, np.maximum.accumulate(fixes.t)[:-1])
    assert fixes.sigma is not None
    return Fixes(fixes.t[keep], fixes.latitude_deg[keep], fixes.longitude_deg[keep], fixes.sigma[keep])
