"""Whether a log and a model can belong together at all, and what such a log cannot show."""

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

# No effect of a real wheel or sensor does what these say.
_MOVING, _ALIKE, _STRANGE = 0.2, 0.9, 0.3
_WRONG_UNIT = 3.0
_ROLLS, _TURNS, _WARMS, _FALLS = 0.05, 0.02, 0.3, 0.03


def check(
    nodes: Sequence[NodeData], inputs: MotionInputs, measured_by: Sequence[str], where: str
) -> list[str]:
    """What a log cannot show, one line each.

    Raises InputError when signs, sides or units of the log are not those of the model, or the inputs are of
    another drive.
    """
    for node in nodes:
        _check_units(node, where)
        if node.on_wheel and node.name not in measured_by and node.used[2]:
            _check_spin(node, where)
    _check_sides([node for node in nodes if node.on_wheel and node.used[2]], where)
    return _unseen(nodes, inputs)


def _check_units(node: NodeData, where: str) -> None:
    if node.used[3:].all():
        words = explain_suspect_units(node.y[:3].T, node.y[3:].T)
        if words is not None:
            raise InputError(f"{where}: {node.name}: {words}")


def _check_spin(node: NodeData, where: str) -> None:
    expected, measured = _spins(node)
    moves = float(np.sqrt(np.mean(expected**2)))
    reads = float(np.sqrt(np.mean(measured**2)))
    if moves < _MOVING:
        if reads > 5.0 * _MOVING:
            raise InputError(
                f"{where}: {node.name}.gz turns with {reads:.2g} rad/s while the speed input stands still; "
                "give the inputs of this drive, or another channel in [inputs]"
            )
        return
    factor, alike = reads / moves, _correlation(expected, measured)
    if alike < -_ALIKE:
        other = "right" if node.mount.facing == "left" else "left"
        raise InputError(
            f'{where}: {node.name}.gz turns against the speed: write facing = "{other}" in '
            f"[nodes.{node.name}], or give the speed input the other sign"
        )
    if alike > _ALIKE and not 1.0 / _WRONG_UNIT < factor < _WRONG_UNIT:
        degrees = "; it looks to be in degrees per second" if 45.0 < factor < 70.0 else ""
        raise InputError(
            f"{where}: {node.name}.gz is {factor:.3g} times what speed and wheel_radius make{degrees}; write "
            "rates in rad/s and speeds in m/s, and check wheel_radius"
        )
    if reads > _MOVING and (abs(alike) < _STRANGE or factor > _WRONG_UNIT):
        raise InputError(
            f"{where}: {node.name}.gz has nothing to do with the speed input; give "
            "the inputs of this drive, or another channel in [inputs]"
        )


def _check_sides(nodes: Sequence[NodeData], where: str) -> None:
    left = next((node for node in nodes if node.mount.side == "left"), None)
    right = next((node for node in nodes if node.mount.side == "right"), None)
    if left is None or right is None:
        return
    (expected, measured), (other, seen) = _spins(left), _spins(right)
    ahead = expected - np.interp(left.t, right.t, other)
    reads = measured - np.interp(left.t, right.t, seen)
    if np.sqrt(np.mean(ahead**2)) > _MOVING and _correlation(ahead, reads) < -_ALIKE:
        raise InputError(
            f"{where}: in turns {left.name} spins as {right.name} should: exchange their sides in [nodes], "
            "or give the yaw rate the other sign (anticlockwise seen from above is positive)"
        )


def _spins(node: NodeData) -> tuple[Array, Array]:
    """(N,) rad/s, forwards: what the inputs make of a wheel's spin, and what its gyro reads."""
    rolling = node.forward.mean_reading((), NodeInitialState()).rolling
    assert rolling is not None
    return rolling.spin, facing_sign(node.mount.facing or "left") * node.y[2]


def _correlation(a: Array, b: Array) -> float:
    """About zero, not about the mean: a sign matters even at constant speed."""
    sizes = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / max(sizes, 1e-300)


def _unseen(nodes: Sequence[NodeData], inputs: MotionInputs) -> list[str]:
    body = inputs.at(nodes[0].t)
    lines = []
    if np.abs(body.speed).max() < _ROLLS:
        still = "nothing moves" if np.abs(body.yaw_rate).max() < _TURNS else "the wheels do not roll"
        lines.append(
            f"{still}: effects of wheels and mounting, scale and axes of the gyros cannot be seen; drive"
        )
    elif np.abs(body.yaw_rate).max() < _TURNS:
        lines.append(
            "the vehicle does not turn: track_width, wheel_camber in gz, scale errors of gx and gy cannot be "
            "seen; turn both ways"
        )
    temperatures = [node.forward.inputs.temperature.values for node in nodes]
    if max(float(np.ptp(values)) for values in temperatures) < _WARMS:
        lines.append("the temperature does not change, or was not recorded: gyro_temperature cannot be seen")
    if "gyro_supply" in BY_NAME:
        steady = [node.name for node in nodes if np.ptp(node.forward.inputs.supply.values) < _FALLS]
        lines += [
            f"{name}: the supply does not change, or was not recorded: gyro_supply cannot be seen"
            for name in steady
        ]
    return lines
