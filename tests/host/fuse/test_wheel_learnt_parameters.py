"""Parameters learnt from positions: what counts as determined, as implausible and as not observable."""

import math

import pytest

from hubodo.calibration.file import Quantity
from hubodo.errors import CalibrationError
from hubodo.fuse.wheel.calibration.learnt_parameters import extract_parameters, quantities_as_json
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import (
    ANTENNA_X,
    GYRO_BIAS_Z,
    GYRO_SCALE_ACROSS,
    LEVER_ARM_X,
    SPEED,
    TRACK_WIDTH,
    WHEEL_RADIUS,
    Entry,
)
from hubodo.fuse.wheel.filter_core import FilterCore


def _core(facing: str = "left", *names: str) -> FilterCore:
    nodes = {name: WheelNode(name, facing) for name in names or ("left", "right")}  # type: ignore[arg-type]
    return FilterCore(WheelConfig(0.15, 0.5, nodes, position_aided=True))


def _learn(core: FilterCore, entry: Entry, value: float, share: float, node: str | None = "left") -> None:
    """Set an entry to a value with a share of its prior sigma."""
    columns = (
        core.columns.vehicle if node is None else next(it.columns for it in core.wheels if it.name == node)
    )
    core.x[columns[entry]] = value
    core.p[columns[entry], columns[entry]] *= share**2


def test_a_parameter_counts_once_the_drive_halved_its_prior_sigma() -> None:
    core, before = _core(), _core()
    _learn(core, WHEEL_RADIUS, 0.01, 0.49)
    _learn(core, WHEEL_RADIUS, 0.01, 0.51, "right")
    learnt = extract_parameters(core, before, math.pi, 120.0)
    assert learnt.nodes["left"]["wheel_radius"]["error"].value == 0.01
    assert "wheel_radius" not in learnt.nodes["right"]
    (line,) = [line for line in learnt.not_observable if line.startswith("right.wheel_radius")]
    assert "only 180° of turning, 120 m" in line


def test_the_sigma_includes_the_model_error() -> None:
    """A radius changes with load and speed: 5e-4; an arm is known to 2 % and 0.1 mm."""
    core, before = _core(), _core()
    _learn(core, WHEEL_RADIUS, 0.01, 1e-6)
    _learn(core, LEVER_ARM_X, 0.02, 1e-6)
    effects = extract_parameters(core, before, 1.0, 1.0).nodes["left"]
    assert effects["wheel_radius"]["error"].sigma == pytest.approx(5e-4, rel=1e-3)
    assert effects["lever_arm"]["x"].sigma == pytest.approx(0.02 * 0.02 + 1e-4, rel=1e-3)


@pytest.mark.parametrize(("facing", "sign"), [("left", 1.0), ("right", -1.0)])
def test_values_are_those_of_node_axes_and_a_shared_scale_counts_for_both_axes(
    facing: str, sign: float
) -> None:
    core, before = _core(facing), _core(facing)
    _learn(core, GYRO_BIAS_Z, 0.003, 0.1)
    _learn(core, GYRO_SCALE_ACROSS, 0.004, 0.1)
    effects = extract_parameters(core, before, 1.0, 1.0).nodes["left"]
    # A node that faces right has its z axis turned over; a scale has no direction.
    assert effects["gyro_bias"]["z"].value == sign * 0.003
    scales = effects["gyro_scale_factor"]
    assert scales["x"] == scales["y"] and scales["x"].value == 0.004


def test_a_value_beyond_four_prior_sigmas_is_refused_with_its_likely_cause() -> None:
    core, before = _core(), _core()
    _learn(core, TRACK_WIDTH, 3.9 * TRACK_WIDTH.prior, 0.1, None)
    assert "track_width" in extract_parameters(core, before, 1.0, 1.0).vehicle
    _learn(core, TRACK_WIDTH, 4.1 * TRACK_WIDTH.prior, 0.1, None)
    with pytest.raises(
        CalibrationError, match=r"comes out as .*4\.1 of the .*another track_width.*nothing is written"
    ):
        extract_parameters(core, before, 1.0, 1.0)


def test_a_refused_radius_is_given_in_metres() -> None:
    core, before = _core(), _core()
    _learn(core, WHEEL_RADIUS, 0.1, 0.1)
    radius = 1.1 * core.config.radius
    with pytest.raises(CalibrationError, match=f"a radius of {radius:.4g} m"):
        extract_parameters(core, before, 1.0, 1.0)


def test_a_single_node_cannot_show_the_track_width() -> None:
    core = _core("left", "left")
    learnt = extract_parameters(core, _core("left", "left"), 1.0, 1.0)
    assert learnt.vehicle == {}
    assert learnt.not_observable[-1].startswith("vehicle.track_width.error: one node does not show it")


def test_the_antenna_is_reported_and_what_no_drive_can_excite_is_not() -> None:
    core = _core()
    _learn(core, ANTENNA_X, 0.7, 0.1, None)
    _learn(core, SPEED, 3.0, 0.1, None)
    learnt = extract_parameters(core, _core(), 1.0, 1.0)
    assert learnt.antenna[0].value == 0.7
    assert learnt.vehicle == {} and all(not effects for effects in learnt.nodes.values())


def test_json_has_value_and_sigma_of_each_parameter() -> None:
    assert quantities_as_json({"gyro_bias": {"z": Quantity(0.1, 0.02)}}) == {
        "gyro_bias": {"z": {"value": 0.1, "sigma": 0.02}}
    }
