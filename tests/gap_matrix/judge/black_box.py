"""A black-box model of the residual, which reduces the gap without naming any effect.

Each channel of each node by ridge regression on smooth functions of what drives the wheel: harmonics of its
angle, times powers of speed and turning, plus temperature and time. Fitted to what is not held out.
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
RIDGE = 1e-4  # of the samples' number, with columns of unit size
HARMONICS = 3


def held_out(folder: Path) -> dict[str, float]:
    """Return the held-out gap before and after fitting the black box."""
    recording, model = read_folder(folder), read_model(folder / "model.toml")
    everything = _Everything()
    residuals = find_gap(recording, model, reject=everything).residual_steps[0]
    inside = split_held_out(build_problem(recording, model)).masks
    before = compute_gap(residuals, inside)
    for name, residual in residuals.items():
        columns = _columns(residual.node)
        fitted = ~inside[name]
        scaled = residual.value / residual.declared_sigma
        part = columns[fitted]
        normal = part.T @ part + RIDGE * len(part) * np.eye(part.shape[1])
        weight = np.linalg.solve(normal, part.T @ scaled[:, fitted].T)
        residual.value[:] = (scaled - (columns @ weight).T) * residual.declared_sigma
    return {"before": before, "after": compute_gap(residuals, inside)}


class _Everything(frozenset[str]):
    def __contains__(self, name: object) -> bool:
        return True


def _columns(node: NodeData) -> Array:
    """Return regressors, (N, k), of unit size."""
    body = node.forward.inputs.at(node.t)
    side = {"left": 0.5, "right": -0.5}.get(node.mount.side or "", 0.0)
    angle = (body.distance - side * node.forward.track_width * body.heading) / node.forward.wheel_radius
    spin = np.gradient(angle, node.t)
    pull = np.gradient(spin, node.t)
    slow = [np.ones(len(spin)), spin, spin**2, spin**3, body.yaw_rate, body.yaw_rate * spin, pull]
    turning = [
        f(k * angle) * one
        for k in range(1, HARMONICS + 1)
        for f in (np.cos, np.sin)
        for one in (slow[0], spin, spin**2, body.yaw_rate, pull)
    ]
    u = np.linspace(-1.0, 1.0, len(spin))
    warm = body.temperature - np.mean(body.temperature)
    made = np.column_stack([*slow, *turning, u, u**2, u**3, warm, warm * spin])
    return made / np.maximum(np.sqrt(np.mean(made**2, 0)), 1e-9)
