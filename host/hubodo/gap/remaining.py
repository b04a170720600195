"""What no effect explains: noise that is not as declared, and structure that is left in a channel."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.problem import CHANNELS, Problem
from hubodo.gap.refit import Refit
from hubodo.gap.result import Left
from hubodo.gap.scatter.base import rests
from hubodo.gap.scatter.wild import spiky_channels
from hubodo.gap.size import Trace
from hubodo.gap.unlisted import unlisted
from hubodo.gap.wander import Weights

_NOISY = 1.15
# Evidence (ln) that makes structure worth a word though it was not added.
_WORTH = 6.0


def remaining(
    problem: Problem, final: Refit, weights: Weights, traced: Mapping[str, Trace]
) -> tuple[list[Left], bool]:
    """What is left, and whether any of it is structure rather than noise."""
    left = []
    for name, trace in traced.items():
        found = weights.noise[name].found
        for row in np.flatnonzero(trace.node.used):
            # From sample to sample the noise of the inputs, which are smooth, is not seen.
            sensor = np.sqrt(trace.declared[row] ** 2 - trace.inputs[row] ** 2)
            ratio = float(np.sqrt(np.mean((found[row] / sensor) ** 2)))
            if ratio > _NOISY or ratio < 1.0 / _NOISY:
                size = "larger" if ratio > 1.0 else "smaller"
                one = float(np.sqrt(np.mean(found[row] ** 2)))
                unit = "rad/s" if row < 3 else "m/s²"
                left.append(
                    Left(
                        f"{name}.{CHANNELS[row]}",
                        "all the time"
                        if np.ptp(found[row]) < 0.2 * one
                        else "more at some speeds than at others",
                        f"noise {size} than declared: {one:.3g} {unit}, "
                        f"{ratio:.2f} times what the model says",
                    )
                )
    spiky = False
    for rest in rests(problem, final.state, weights):
        if BY_NAME["outliers"] in rest.effects:
            continue
        for at, count, height in spiky_channels(rest):
            channel = f"{rest.node.name}.{CHANNELS[at]}"
            words = f"spikes, jumps of about {height:.0f} times the noise and back"
            left.append(Left(channel, f"in {count} single samples", words))
            spiky = True
    structures = unlisted(problem, final.state, rests(problem, final.state, weights))
    told: set[str] = set()
    for structure in structures:
        if structure.evidence < _WORTH:
            continue
        for channel, gain in zip(structure.channels, structure.shares, strict=True):
            name = f"{structure.term.scope}.{channel}"
            if name not in told:
                told.add(name)
                left.append(
                    Left(name, f"goes with {structure.expression}", f"structure, {np.sqrt(2.0 * gain):.0f} σ")
                )
    return left, spiky or bool(told)
