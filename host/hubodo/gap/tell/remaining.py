"""What no effect explains: noise that is not as declared, and structure that is left in a channel."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.problem.problem import CHANNELS
from hubodo.gap.process_noise.point import Point
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.outliers import spiky_channels
from hubodo.gap.screen.unlisted import unlisted
from hubodo.gap.tell.result import Unexplained

# Ratio of the noise that is found to the declared one, or its inverse, that is worth a line.
_NOISY = 1.15
# Evidence (ln) that makes structure worth a word though it was not added.
_WORTH = 6.0


def remaining(final: Point, residuals: Mapping[str, Residual]) -> tuple[list[Unexplained], bool]:
    """What is left at the end of the search, and whether any of it is structure rather than noise."""
    structure = [*_spikes(final), *_structures(final)]
    return [*_noise(residuals), *structure], bool(structure)


def _noise(residuals: Mapping[str, Residual]) -> Iterator[Unexplained]:
    for name, residual in residuals.items():
        for row in np.flatnonzero(residual.node.used):
            found = residual.noise.of(row)
            # From sample to sample the noise of the inputs, which are smooth, is not seen.
            sensor = np.sqrt(residual.declared_of(row) ** 2 - residual.input_sigma[row] ** 2)
            ratio = float(np.sqrt(np.mean((found / sensor) ** 2)))
            if 1.0 / _NOISY <= ratio <= _NOISY:
                continue
            size = "larger" if ratio > 1.0 else "smaller"
            one = float(np.sqrt(np.mean(found**2)))
            always = np.ptp(found) < 0.2 * one
            yield Unexplained(
                f"{name}.{CHANNELS[row]}",
                "all the time" if always else "more at some speeds than at others",
                f"noise {size} than declared: {one:.3g} {'rad/s' if row < 3 else 'm/s²'}, "
                f"{ratio:.2f} times what the model says",
            )


def _spikes(final: Point) -> Iterator[Unexplained]:
    for residual in final.mean_residuals.values():
        if BY_NAME["outliers"] in residual.effects:
            continue
        for at, count, height in spiky_channels(residual):
            channel = f"{residual.node.name}.{CHANNELS[at]}"
            words = f"spikes, jumps of about {height:.0f} times the noise and back"
            yield Unexplained(channel, f"in {count} single samples", words)


def _structures(final: Point) -> Iterator[Unexplained]:
    told: set[str] = set()
    for structure in unlisted(final):
        if structure.evidence < _WORTH:
            continue
        for channel, gain in zip(structure.channels, structure.shares, strict=True):
            name = f"{structure.term.scope}.{channel}"
            if name not in told:
                told.add(name)
                goes_with = f"goes with {structure.expression}"
                yield Unexplained(name, goes_with, f"structure, {np.sqrt(2.0 * gain):.0f} σ")
