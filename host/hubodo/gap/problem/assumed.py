"""A model for a log without a model file: noise and inputs estimated from the log itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Noise
from hubodo.errors import InputError
from hubodo.gap.problem.problem import MIN_NODE_SAMPLES
from hubodo.model.model_file import InputSources, Model
from hubodo.recording import Recording, Table
from hubodo.smoothing_spline import fit_smoothing_spline
from hubodo.vehicle import Vehicle

# Fourth-order differences amplify white noise by sqrt(70) and suppress the slow rotation of a wheel.
_DIFFERENCE_ORDER, _DIFFERENCE_GAIN = 4, 70.0**0.5
# Length of a segment, s, and share of the segments: noise is measured in the quietest quarter, as the road
# shakes the sensor elsewhere.
_NOISE_SEGMENT, _QUIET_FRACTION = 0.5, 0.25
# Cosine of the tilt below which a node on the body measures the yaw rate with its z axis.
_MIN_UPRIGHT_COSINE = 0.97


def assume_model(recording: Recording, vehicle: Vehicle, log_name: str = "log") -> Model:
    """Return a model without effects, with noise estimated from the samples and inputs from the log.

    Inputs are the reference where the log has one; otherwise the speed comes from the wheels' own gyros, and
    the yaw rate from an upright node on the body or from the odometry. Raises InputError for a log without a
    node of the vehicle.
    """
    tables = [
        recording.nodes[name]
        for name in vehicle.nodes
        if len(recording.nodes.get(name, ())) >= MIN_NODE_SAMPLES
    ]
    if not tables:
        raise InputError(
            f"{log_name}: has none of the vehicle's nodes ({', '.join(vehicle.nodes) or 'it names none'}); "
            f"the log has {', '.join(recording.nodes) or 'no node'}; use the same names in [nodes], or "
            "assign topics with --topic"
        )
    noise = Noise(
        *(_round_sigma(_estimate_noise(tables, triad)) for triad in (("gx", "gy", "gz"), ("ax", "ay", "az")))
    )
    return Model(vehicle, noise, _assume_inputs(recording, vehicle, log_name))


def _assume_inputs(recording: Recording, vehicle: Vehicle, log_name: str) -> InputSources:
    table = recording.reference
    if table is not None and len(table) >= 10 and "speed" in table and "yaw_rate" in table:
        noises = (
            _round_sigma(fit_smoothing_spline(table.t, table[name]).noise) for name in ("speed", "yaw_rate")
        )
        return InputSources("reference.speed", "reference.yaw_rate", *noises)
    sides = {m.side: name for name, m in vehicle.nodes.items() if m.side and name in recording.nodes}
    if not sides:
        raise InputError(
            f"{log_name}: has neither a reference nor a node on a wheel: nothing tells the speed"
        )
    speed = "nodes" if len(sides) == 2 else f"nodes.{next(iter(sides.values()))}.gz"
    bodies = [name for name, m in vehicle.nodes.items() if m.side is None and name in recording.nodes]
    upright = (name for name in bodies if _is_upright(recording.nodes[name]))
    body = next(upright, None)
    return InputSources(speed, "nodes" if body is None else f"nodes.{body}.gz")


def _round_sigma(sigma: float) -> float:
    """Round to three significant digits."""
    return float(f"{sigma:.3g}")


def _is_upright(table: Table) -> bool:
    up = np.median(table.accel, axis=0)
    return bool(up[2] > _MIN_UPRIGHT_COSINE * np.linalg.norm(up))


def _estimate_noise(tables: Sequence[Table], channels: Sequence[str]) -> float:
    """Return 1 sigma of white noise, the rms over the channels that change."""
    sigmas = [_estimate_quiet_noise(table.t, table[channel]) for table in tables for channel in channels]
    sigmas = [sigma for sigma in sigmas if sigma > 0.0]
    if not sigmas:
        raise InputError(f"{', '.join(channels)} of no node ever change: nothing was measured")
    return float(np.sqrt(np.mean(np.square(sigmas))))


def _estimate_quiet_noise(t: Array, values: Array) -> float:
    """Return 1 sigma of white noise, measured in every second segment whose predecessor was quiet.

    Selecting segments by the values that are then measured would bias the result low.
    """
    differences = np.diff(values, _DIFFERENCE_ORDER) / _DIFFERENCE_GAIN
    edges = np.unique(np.searchsorted(t[: len(differences)], np.arange(t[0], t[-1], _NOISE_SEGMENT)))
    edges = edges[edges < len(differences)]
    power = np.add.reduceat(differences**2, edges) / np.diff(edges, append=len(differences))
    selecting, measured = power[0 : len(power) // 2 * 2 : 2], power[1::2]
    return float(np.sqrt(np.mean(measured[selecting <= np.quantile(selecting, _QUIET_FRACTION)])))
