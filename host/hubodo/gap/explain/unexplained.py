"""Unexplained residuals: noise that differs from its declaration, and structure left in a channel."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.explain.result import Unexplained
from hubodo.gap.problem.problem import CHANNELS
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.outliers import find_spiky_channels
from hubodo.gap.screen.unnamed_terms import find_unnamed_terms

# Ratio of estimated to declared noise, or its inverse, from which on it is reported.
_MIN_NOISE_RATIO = 1.15
# ln Bayes factor from which on structure is reported although it was not added.
_MIN_STRUCTURE_EVIDENCE = 6.0


def list_unexplained(final: Evaluation, residuals: Mapping[str, Residual]) -> tuple[list[Unexplained], bool]:
    """Return the unexplained residuals, and True if any is structure rather than noise."""
    structure = [*_list_spikes(final), *_list_structure(final)]
    return [*_list_noise(residuals), *structure], bool(structure)


def _list_noise(residuals: Mapping[str, Residual]) -> Iterator[Unexplained]:
    for name, residual in residuals.items():
        for row in np.flatnonzero(residual.node.used):
            sigma = residual.noise.channel_sigma(row)
            # The inputs are smooth: their noise is not visible between consecutive samples.
            sensor = np.sqrt(residual.declared_channel_sigma(row) ** 2 - residual.input_sigma[row] ** 2)
            ratio = float(np.sqrt(np.mean((sigma / sensor) ** 2)))
            if 1.0 / _MIN_NOISE_RATIO <= ratio <= _MIN_NOISE_RATIO:
                continue
            comparison = "larger" if ratio > 1.0 else "smaller"
            rms = float(np.sqrt(np.mean(sigma**2)))
            is_constant = np.ptp(sigma) < 0.2 * rms
            yield Unexplained(
                f"{name}.{CHANNELS[row]}",
                "all the time" if is_constant else "more at some speeds than at others",
                f"noise {comparison} than declared: {rms:.3g} {'rad/s' if row < 3 else 'm/s²'}, "
                f"{ratio:.2f} times what the model says",
            )


def _list_spikes(final: Evaluation) -> Iterator[Unexplained]:
    for residual in final.mean_residuals.values():
        if BY_NAME["outliers"] in residual.effects:
            continue
        for at, count, height in find_spiky_channels(residual):
            channel = f"{residual.node.name}.{CHANNELS[at]}"
            words = f"spikes, jumps of about {height:.0f} times the noise and back"
            yield Unexplained(channel, f"in {count} single samples", words)


def _list_structure(final: Evaluation) -> Iterator[Unexplained]:
    reported: set[str] = set()
    for structure in find_unnamed_terms(final):
        if structure.evidence < _MIN_STRUCTURE_EVIDENCE:
            continue
        for channel, gain in zip(structure.channels, structure.channel_gains, strict=True):
            name = f"{structure.term.scope}.{channel}"
            if name not in reported:
                reported.add(name)
                goes_with = f"goes with {structure.expression}"
                yield Unexplained(name, goes_with, f"structure, {np.sqrt(2.0 * gain):.0f} σ")
