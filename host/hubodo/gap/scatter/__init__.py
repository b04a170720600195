"""Effects visible in scatter, resolution or saturation, not in the mean, each with its own likelihood."""

from hubodo.gap.scatter.base import Proposal, ScatterDetector
from hubodo.gap.scatter.limits import detect_limits
from hubodo.gap.scatter.outliers import detect_outliers
from hubodo.gap.scatter.quantization import detect_quantization
from hubodo.gap.scatter.random_walk import detect_random_walk
from hubodo.gap.scatter.repeats import detect_repeats
from hubodo.gap.scatter.road_bank import detect_road_bank

SCATTER_DETECTORS: tuple[ScatterDetector, ...] = (
    detect_random_walk,
    detect_road_bank,
    detect_limits,
    detect_quantization,
    detect_repeats,
    detect_outliers,
)

__all__ = ["LOOKS", "Proposal"]
