"""A black-box model of the residuals, which reduces the gap without naming any effect.

Each channel is a ridge regression on harmonics of the wheel angle times powers of spin and yaw rate, and on
temperature and time. It is fitted to the samples that are not held out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hubodo.gap.judge.held_out import split_held_out
from hubodo.gap.problem.build import build_problem
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.process_noise.residual import compute_gap
from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

Array = np.ndarray
RIDGE_PER_SAMPLE = 1e-4  # times the number of samples, for columns of unit rms
N_HARMONICS = 3


def compute_held_out_gaps(folder: Path) -> dict[str, float]:
    """Return the held-out gap before and after fitting the black box."""
    recording, model = read_folder(folder), read_model(folder / "model.toml")
    all_names = _AllNames()
    residuals = find_gap(recording, model, reject=all_names).residual_steps[0]
    held_out_masks = split_held_out(build_problem(recording, model)).masks
    before = compute_gap(residuals, held_out_masks)
    for name, residual in residuals.items():
        columns = _columns(residual.node)
        is_fitted = ~held_out_masks[name]
        scaled_residuals = residual.value / residual.declared_sigma
        fitted_columns = columns[is_fitted]
        normal_matrix = fitted_columns.T @ fitted_columns + RIDGE_PER_SAMPLE * len(fitted_columns) * np.eye(
            fitted_columns.shape[1]
        )
        weights = np.linalg.solve(normal_matrix, fitted_columns.T @ scaled_residuals[:, is_fitted].T)
        residual.value[:] = (scaled_residuals - (columns @ weights).T) * residual.declared_sigma
    return {"before": before, "after": compute_gap(residuals, held_out_masks)}


class _AllNames(frozenset[str]):
    """A set that contains every name."""

    def __contains__(self, name: object) -> bool:
        return True


def _columns(node: NodeData) -> Array:
    """Return the regressors, (N, k), of unit rms."""
    inputs = node.forward.inputs.at(node.t)
    side = {"left": 0.5, "right": -0.5}.get(node.mount.side or "", 0.0)
    angle = (inputs.distance - side * node.forward.track_width * inputs.heading) / node.forward.wheel_radius
    spin = np.gradient(angle, node.t)
    spin_acceleration = np.gradient(spin, node.t)
    slow_terms = [
        np.ones(len(spin)),
        spin,
        spin**2,
        spin**3,
        inputs.yaw_rate,
        inputs.yaw_rate * spin,
        spin_acceleration,
    ]
    harmonic_terms = [
        function(k * angle) * factor
        for k in range(1, N_HARMONICS + 1)
        for function in (np.cos, np.sin)
        for factor in (slow_terms[0], spin, spin**2, inputs.yaw_rate, spin_acceleration)
    ]
    relative_time = np.linspace(-1.0, 1.0, len(spin))
    temperature_change = inputs.temperature - np.mean(inputs.temperature)
    columns = np.column_stack(
        [
            *slow_terms,
            *harmonic_terms,
            relative_time,
            relative_time**2,
            relative_time**3,
            temperature_change,
            temperature_change * spin,
        ]
    )
    return columns / np.maximum(np.sqrt(np.mean(columns**2, 0)), 1e-9)
