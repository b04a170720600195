"""Settings of the factor graph: priors, sensor sigmas and the limits of adaptation."""

from __future__ import annotations

from dataclasses import dataclass, field

from hubodo.fuse.graph.factors.constants import ConstantSigmas
from hubodo.fuse.graph.odometry_steps import StepNoise


@dataclass(frozen=True, slots=True)
class GraphConfig:
    """Prior knowledge of a drive, and options of the graph.

    Attributes
    ----------
    antenna : m forward and left of the body origin.
    gnss_sigma : m, of fixes without a sigma, or of all fixes when `use_declared_sigmas` is false; 5 m is that
        of a single-frequency receiver under an open sky.
    heading_sigma : rad, of headings without a sigma; 5 deg is that of a compass on a steel vehicle.
    use_declared_sigmas : whether the receiver's sigmas are used.
    noise : random errors of the odometry.
    constants : prior sigmas of the constant errors.
    max_pose_spacing : s between poses.
    start_heading : rad, of the first pose if known, else it is estimated.
    start_heading_sigma : rad.
    inflate_sigmas : whether fix errors that are correlated in time, or exceed the receiver's sigma, inflate
        it.
    estimate_delay : whether a significant time offset of the fixes is removed.
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
