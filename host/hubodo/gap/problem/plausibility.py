"""Check that a log can belong to a model, and list of properties that the log cannot show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.errors import InputError
from hubodo.gap.problem.problem import NodeData
from hubodo.log.units import explain_suspect_units
from hubodo.model.forward import NodeInitialState
from hubodo.model.inputs import MotionInputs
from hubodo.vehicle import facing_sign

# Bounds of a rate, rad/s, and of correlations that no effect of a real wheel or sensor crosses.
_MIN_SPIN, _MIN_CORRELATION, _MAX_UNRELATED_CORRELATION = 0.2, 0.9, 0.3
_MAX_SPIN_RATIO = 3.0
_MIN_SPEED, _MIN_YAW_RATE, _MIN_TEMPERATURE_CHANGE, _MIN_SUPPLY_CHANGE = 0.05, 0.02, 0.3, 0.03


def check_plausibility(
    nodes: Sequence[NodeData], inputs: MotionInputs, speed_sources: Sequence[str], log_name: str
) -> list[str]:
    """Return the properties that a log cannot show, one line each.

    Raises InputError if signs, sides or units of the log contradict the model, or the inputs are of another
    drive.
    """
    for node in nodes:
        _check_units(node, log_name)
        if node.on_wheel and node.name not in speed_sources and node.used[2]:
            _check_spin(node, log_name)
    _check_sides([node for node in nodes if node.on_wheel and node.used[2]], log_name)
    return _list_unobservable(nodes, inputs)


def _check_units(node: NodeData, log_name: str) -> None:
    if node.used[3:].all():
        words = explain_suspect_units(node.y[:3].T, node.y[3:].T)
        if words is not None:
            raise InputError(f"{log_name}: {node.name}: {words}")


def _check_spin(node: NodeData, log_name: str) -> None:
    expected, measured = _wheel_spins(node)
    expected_rms = float(np.sqrt(np.mean(expected**2)))
    measured_rms = float(np.sqrt(np.mean(measured**2)))
    if expected_rms < _MIN_SPIN:
        if measured_rms > 5.0 * _MIN_SPIN:
            raise InputError(
                f"{log_name}: {node.name}.gz turns with {measured_rms:.2g} rad/s while the speed input is 0; "
                "use the inputs of this drive, or another channel in [inputs]"
            )
        return
    factor, correlation = measured_rms / expected_rms, _correlation(expected, measured)
    if correlation < -_MIN_CORRELATION:
        other = "right" if node.mount.facing == "left" else "left"
        raise InputError(
            f'{log_name}: {node.name}.gz turns against the speed: write facing = "{other}" in '
            f"[nodes.{node.name}], or give the speed input the other sign"
        )
    if correlation > _MIN_CORRELATION and not 1.0 / _MAX_SPIN_RATIO < factor < _MAX_SPIN_RATIO:
        degrees = "; it looks to be in degrees per second" if 45.0 < factor < 70.0 else ""
        raise InputError(
            f"{log_name}: {node.name}.gz is {factor:.3g} times speed / wheel_radius{degrees}; give rates in "
            "rad/s and speeds in m/s, and check wheel_radius"
        )
    if measured_rms > _MIN_SPIN and (
        abs(correlation) < _MAX_UNRELATED_CORRELATION or factor > _MAX_SPIN_RATIO
    ):
        raise InputError(
            f"{log_name}: {node.name}.gz is unrelated to the speed input; use the inputs of this drive, "
            "or another channel in [inputs]"
        )


def _check_sides(nodes: Sequence[NodeData], log_name: str) -> None:
    left = next((node for node in nodes if node.mount.side == "left"), None)
    right = next((node for node in nodes if node.mount.side == "right"), None)
    if left is None or right is None:
        return
    (expected, measured), (expected_right, measured_right) = _wheel_spins(left), _wheel_spins(right)
    expected_difference = expected - np.interp(left.t, right.t, expected_right)
    measured_difference = measured - np.interp(left.t, right.t, measured_right)
    if (
        np.sqrt(np.mean(expected_difference**2)) > _MIN_SPIN
        and _correlation(expected_difference, measured_difference) < -_MIN_CORRELATION
    ):
        raise InputError(
            f"{log_name}: in turns {left.name} spins as {right.name} should: swap their sides in [nodes], or "
            "change the sign of the yaw rate (anticlockwise seen from above is positive)"
        )


def _wheel_spins(node: NodeData) -> tuple[Array, Array]:
    """Return the forward spin of a wheel, (N,) rad/s, predicted from the inputs and measured by the gyro."""
    rolling = node.forward.mean_reading((), NodeInitialState()).rolling
    assert rolling is not None
    return rolling.spin, facing_sign(node.mount.facing or "left") * node.y[2]


def _correlation(a: Array, b: Array) -> float:
    """Return the correlation about zero, not about the mean: the sign matters even at constant speed."""
    sizes = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / max(sizes, 1e-300)


def _list_unobservable(nodes: Sequence[NodeData], inputs: MotionInputs) -> list[str]:
    body = inputs.at(nodes[0].t)
    lines = []
    if np.abs(body.speed).max() < _MIN_SPEED:
        reason = "nothing moves" if np.abs(body.yaw_rate).max() < _MIN_YAW_RATE else "the wheels do not roll"
        lines.append(
            f"{reason}: effects of wheels and mounting, scale and axes of the gyros cannot be seen; drive"
        )
    elif np.abs(body.yaw_rate).max() < _MIN_YAW_RATE:
        lines.append(
            "the vehicle does not turn: track_width, wheel_camber in gz, scale errors of gx and gy cannot be "
            "seen; turn both ways"
        )
    temperatures = [node.forward.inputs.temperature.values for node in nodes]
    if max(float(np.ptp(values)) for values in temperatures) < _MIN_TEMPERATURE_CHANGE:
        lines.append("the temperature does not change, or was not recorded: gyro_temperature cannot be seen")
    if "gyro_supply" in BY_NAME:
        steady = [
            node.name for node in nodes if np.ptp(node.forward.inputs.supply.values) < _MIN_SUPPLY_CHANGE
        ]
        lines += [
            f"{name}: the supply does not change, or was not recorded: gyro_supply cannot be seen"
            for name in steady
        ]
    return lines
