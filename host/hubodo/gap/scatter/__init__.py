"""Effects that show in scatter, steps and limits, not in the mean: each has a likelihood of its own."""

from hubodo.gap.scatter.base import Look, Proposal
from hubodo.gap.scatter.limits import look_for_limits
from hubodo.gap.scatter.outliers import look_for_outliers
from hubodo.gap.scatter.quantization import look_for_quantization
from hubodo.gap.scatter.random_walk import look_for_random_walk
from hubodo.gap.scatter.repeats import look_for_repeats

LOOKS: tuple[Look, ...] = (
    look_for_random_walk,
    look_for_limits,
    look_for_quantization,
    look_for_repeats,
    look_for_outliers,
)

__all__ = ["LOOKS", "Proposal"]
