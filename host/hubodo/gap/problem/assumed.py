"""A model of a vehicle for which nobody wrote a model file: noise and inputs as the log itself shows them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Noise
from hubodo.errors import InputError
from hubodo.model.model_file import InputSources, Model
from hubodo.recording import Recording, Table
from hubodo.smoothing_spline import fit_smoothing_spline
from hubodo.vehicle import Vehicle

# Differences of the fourth order see white noise times sqrt(70), and nothing of what a wheel turns slowly.
_ORDER, _GROWN = 4, 70.0**0.5
# s: stretches of which the quietest quarter tells the noise: a road shakes what rolls on it.
_STRETCH, _QUIET = 0.5, 0.25
# A node on the body whose z axis is so near to upright, as a cosine, measures the yaw rate.
_UPRIGHT = 0.97
_LEAST = 100


def assumed_model(recording: Recording, vehicle: Vehicle, where: str = "log") -> Model:
    """The vehicle's own model: nothing in it, the noise of each triad as its samples scatter.

    Its inputs are the reference where the log has one, else speed from the wheels' own gyros and the yaw rate
    of an upright node on the body, or else what the odometry makes of the gyros across the axles. Raises
    InputError for a log without a node of the vehicle.
    """
    tables = [recording.nodes[name] for name in vehicle.nodes if len(recording.nodes.get(name, ())) >= _LEAST]
    if not tables:
        raise InputError(
            f"{where}: has none of the vehicle's nodes ({', '.join(vehicle.nodes) or 'it names none'}); the "
            f"log has {', '.join(recording.nodes) or 'no node'}; name them alike in [nodes], or say which "
            "topic is which with --topic"
        )
    noise = Noise(*(_rounded(_noise(tables, triad)) for triad in (("gx", "gy", "gz"), ("ax", "ay", "az"))))
    return Model(vehicle, noise, _inputs(recording, vehicle, where))


def _inputs(recording: Recording, vehicle: Vehicle, where: str) -> InputSources:
    table = recording.reference
    if table is not None and len(table) >= 10 and "speed" in table and "yaw_rate" in table:
        noises = (
            _rounded(fit_smoothing_spline(table.t, table[name]).noise) for name in ("speed", "yaw_rate")
        )
        return InputSources("reference.speed", "reference.yaw_rate", *noises)
    sides = {m.side: name for name, m in vehicle.nodes.items() if m.side and name in recording.nodes}
    if not sides:
        raise InputError(f"{where}: has neither a reference nor a node on a wheel: nothing tells the speed")
    speed = "nodes" if len(sides) == 2 else f"nodes.{next(iter(sides.values()))}.gz"
    bodies = [name for name, m in vehicle.nodes.items() if m.side is None and name in recording.nodes]
    upright = (name for name in bodies if _upright(recording.nodes[name]))
    body = next(upright, None)
    return InputSources(speed, "nodes" if body is None else f"nodes.{body}.gz")


def _rounded(sigma: float) -> float:
    """To the three digits that a sigma deserves in a file."""
    return float(f"{sigma:.3g}")


def _upright(table: Table) -> bool:
    up = np.median(table.accel, axis=0)
    return bool(up[2] > _UPRIGHT * np.linalg.norm(up))


def _noise(tables: Sequence[Table], channels: Sequence[str]) -> float:
    """1 sigma of white noise, the mean of those channels that change."""
    found = [_quiet(table.t, table[channel]) for table in tables for channel in channels]
    found = [sigma for sigma in found if sigma > 0.0]
    if not found:
        raise InputError(f"{', '.join(channels)} of no node ever change: nothing was measured")
    return float(np.sqrt(np.mean(np.square(found))))


def _quiet(t: Array, values: Array) -> float:
    """1 sigma of what scatters in each second stretch, where the one before it was quiet.

    To choose by what is then measured would choose those that are small by chance.
    """
    bent = np.diff(values, _ORDER) / _GROWN
    edges = np.unique(np.searchsorted(t[: len(bent)], np.arange(t[0], t[-1], _STRETCH)))
    edges = edges[edges < len(bent)]
    power = np.add.reduceat(bent**2, edges) / np.diff(edges, append=len(bent))
    chosen, measured = power[0 : len(power) // 2 * 2 : 2], power[1::2]
    return float(np.sqrt(np.mean(measured[chosen <= np.quantile(chosen, _QUIET)])))
