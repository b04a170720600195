"""Settings of the factor graph: what is known beforehand, and the limits of belief."""

from __future__ import annotations

from dataclasses import dataclass, field

from hubodo.fuse.graph.factors.constants import ConstantSigmas
from hubodo.fuse.graph.odometry_steps import StepNoise


@dataclass(frozen=True, slots=True)
class GraphConfig:
    """What the graph takes for granted of a drive.

    antenna: m forward and left of the body origin. gnss_sigma: m and heading_sigma: rad, of measurements that
    do not say, or of all fixes when `declared` is false: 5 m of a single-frequency receiver under an open
    sky, 5 deg of a compass on a vehicle of steel. knot: s, poses are not further apart than that.
    start_heading: rad, of the first pose if known to start_heading_sigma, else found. honest: whether errors
    of fixes that last, or exceed what the receiver says, widen the sigmas. search_delay: whether a time
    offset of the fixes that they plainly show is undone.
    """

    antenna: tuple[float, float] = (0.0, 0.0)
    gnss_sigma: float = 5.0
    heading_sigma: float = 0.09
    use_declared_sigmas: bool = True
    noise: StepNoise = field(default_factory=StepNoise)
    constants: ConstantSigmas = field(default_factory=ConstantSigmas)
    max_pose_spacing: float = 1.0
    start_heading: float | None = None
    start_heading_sigma: float = 0.02
    inflate_sigmas: bool = True
    estimate_delay: bool = True
