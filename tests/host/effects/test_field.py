"""Effects on request: each against its formula, and identified in a log of an independent simulator."""

import shutil

import numpy as np
import pytest

from gap_matrix import beyond, cases, recording
from gap_runs import run_gap
from hubodo.effects import BY_NAME, EFFECTS
from hubodo.effects.field import FIELD_EFFECTS
from hubodo.effects.loaded import use_effects
from hubodo.effects.sensor_chain import SensorChain

SEED = 20
T = np.linspace(0.0, 20.0, 2001)


pytestmark = pytest.mark.usefixtures("restore_effects_after_each")


def chain(facing=1.0):
    rng = np.random.default_rng(SEED)
    rate, force = rng.standard_normal((2, 3, len(T)))
    result = SensorChain(
        T, 25.0 + 0.3 * T, rate, 0.0 * rate, force, np.zeros_like(rate), np.zeros_like(force)
    )
    result.facing, result.angle, result.spin = facing, 5.0 * T, np.full(len(T), 5.0)
    result.speed, result.acceleration = 2.0 + np.sin(0.5 * T), 0.5 * np.cos(0.5 * T)
    result.yaw_rate, result.yaw_acceleration = 0.4 * np.sin(0.3 * T), 0.12 * np.cos(0.3 * T)
    return result


def added(name, facing=1.0, **values):
    kind = next(kind for kind in FIELD_EFFECTS if kind.name == name)
    result = chain(facing)
    kind(**values).add_offsets(result)
    return result.gyro, result.accel


@pytest.mark.parametrize("facing", [1.0, -1.0])
def test_a_steered_wheel_turns_at_the_rate_of_its_angle(facing):
    gyro, accel = added("wheel_steering", facing, arm=0.4)
    on = chain()
    angle = 0.4 * on.speed * on.yaw_rate / (on.speed**2 + 0.25)
    rate = np.gradient(angle, T, edge_order=2)
    # The derivative of samples a hundredth of a second apart is accurate to 1e-4.
    np.testing.assert_allclose(gyro[0], np.cos(5.0 * T) * rate, atol=2e-5)
    np.testing.assert_allclose(gyro[1], -facing * np.sin(5.0 * T) * rate, atol=2e-5)
    assert not gyro[2].any() and not accel.any()


def test_play_tilts_the_node_by_the_sign_of_the_torque():
    gyro, accel = added("axle_play", x=1e-3, y=-2e-3)
    on = chain()
    for k in (100, 500, 900):
        end = np.tanh(on.acceleration[k] / 0.05)
        turn = end * np.array([[0.0, 0.0, -2e-3], [0.0, 0.0, -1e-3], [2e-3, 1e-3, 0.0]])
        np.testing.assert_allclose(gyro[:, k], -turn @ on.rate[:, k], atol=1e-12)
        np.testing.assert_allclose(accel[:, k], -turn @ on.force[:, k], atol=1e-12)


def test_vibration_and_temperature_shift_the_accelerometer():
    gyro, accel = added("accel_rectification", x=0.01, z=-0.02)
    np.testing.assert_allclose(accel[0], 0.01 * chain().speed ** 2)
    np.testing.assert_allclose(accel[2], -0.02 * chain().speed ** 2)
    assert not accel[1].any() and not gyro.any()
    _, accel = added("accel_temperature", y=0.02)
    np.testing.assert_allclose(accel[1], 0.02 * 0.3 * T)


def test_the_supply_above_3_7_volts_shifts_the_gyro():
    kind = next(kind for kind in FIELD_EFFECTS if kind.name == "gyro_supply")
    result = chain()
    result.supply = 4.1 - 0.035 * T
    kind(x=0.02, y=-0.01, z=0.03).add_offsets(result)
    # 4.1 V is 0.4 V above and 3.4 V is 0.3 V below nominal: 8, -4, 12 mrad/s and -6, 3, -9 mrad/s.
    np.testing.assert_allclose(result.gyro[:, 0], [0.008, -0.004, 0.012], atol=1e-15)
    np.testing.assert_allclose(result.gyro[:, -1], [-0.006, 0.003, -0.009], atol=1e-15)
    assert not result.accel.any()
    unknown = chain()
    kind(x=0.02).add_offsets(unknown)
    assert not unknown.gyro.any()


@pytest.mark.parametrize("facing", [1.0, -1.0])
def test_on_a_banked_road_gravity_has_a_lateral_component(facing):
    _, accel = added("mean_road_bank", facing, angle=0.1)
    # On a level road the vertical is (0, 0, 1) in the body; on a banked one it is (0, sin, cos).
    change = 9.80665 * np.array([0.0, np.sin(0.1), np.cos(0.1) - 1.0])
    c, s = np.cos(5.0 * T), np.sin(5.0 * T)
    axes = np.array([[s, 0.0 * c, c], [facing * c, 0.0 * c, -facing * s]])
    np.testing.assert_allclose(accel[:2], np.einsum("ijn,j->in", axes, change), atol=1e-12)
    np.testing.assert_allclose(accel[2], facing * change[1])


def test_a_late_reference_makes_every_node_early():
    kind = next(kind for kind in FIELD_EFFECTS if kind.name == "reference_latency")
    np.testing.assert_allclose(kind(0.1).true_time(T), T + 0.1)


def test_further_effects_are_candidates_on_request_only():
    bench_only = {kind.name for kind in FIELD_EFFECTS} & set(BY_NAME)
    assert bench_only == {"accel_temperature"} and not BY_NAME["accel_temperature"].fitted_parameters()
    use_effects(field=True)
    assert list(BY_NAME) == list(dict.fromkeys(kind.name for kind in (*EFFECTS, *FIELD_EFFECTS)))
    assert BY_NAME["accel_temperature"].fitted_parameters() == ("x", "y", "z")


@pytest.mark.parametrize("kind", FIELD_EFFECTS, ids=lambda kind: kind.name)
def test_each_effect_names_confusable_effects_and_manoeuvres(kind):
    assert kind.confusable_with
    assert all(other in BY_NAME and manoeuvre for other, manoeuvre in kind.confusable_with.items())
    assert kind.meaning


def draw_setup():
    """Return a drive of 40 s at a third of the usual rate."""
    return cases.resample_nodes(cases.draw_setup(SEED, duration=40.0), 30.0, np.random.default_rng(SEED))


def test_a_steered_wheel_of_an_independent_simulator_is_identified_on_request(tmp_path):
    setup = draw_setup()
    hidden = beyond.hide_effect(setup, "steered_wheel", 2000.0)
    recording.write_case_files(setup, [], tmp_path / "case", {}, hidden.records)
    gap_run = run_gap(
        tmp_path / "out", tmp_path / "case/model.toml", tmp_path / "case", "--candidates", "field"
    )
    assert gap_run.names == [("wheel_steering", hidden.node)]
    arm = gap_run.result["found"][0]["parameters"]["arm"]
    assert abs(arm["value"] - hidden.truth["yaw"]) < 3.0 * arm["sigma"]


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """A log by an independent simulator."""
    path = tmp_path_factory.mktemp("foreign") / "case"
    recording.write_case_files(draw_setup(), [], path, {})
    return path


@pytest.fixture
def case(foreign, tmp_path):
    """A copy of that log to be changed."""
    return shutil.copytree(foreign, tmp_path / "case")


@pytest.mark.repeat
def test_an_off_centre_reference_antenna_is_identified_on_request(case, tmp_path):
    """The log with the speed of another point: v - r arm."""
    arm = -0.2
    head, rows = (case / "reference.csv").read_text().split("\n", 1)
    table = np.array([line.split(",") for line in rows.split()], float)
    table[:, 1] -= arm * table[:, 2]
    np.savetxt(case / "reference.csv", table, fmt="%.7f", delimiter=",", header=head, comments="")
    gap_run = run_gap(tmp_path / "out", case / "model.toml", case, "--candidates", "field")
    assert gap_run.names == [("reference_arm", "vehicle")]
    value = gap_run.result["found"][0]["parameters"]["arm"]
    assert abs(value["value"] - arm) < 3.0 * value["sigma"]


def supplied(case, shift):
    """The log with a supply that is drained in two bursts, which shifts the left gyro by rad/s per V."""
    for node in ("left", "right"):
        head, rows = (case / f"{node}.csv").read_text().split("\n", 1)
        table = np.array([line.split(",") for line in rows.split()], float)
        share = table[:, 0] / table[-1, 0]
        volts = np.round(4.1 - 0.4 / (1 + np.exp(25 * (0.3 - share))) - 0.3 * (share > 0.7), 3)
        if node == "left":
            table[:, 1:4] += (volts - 3.7)[:, None] * shift
        columns = np.column_stack([table, volts])
        np.savetxt(
            case / f"{node}.csv", columns, fmt="%.7f", delimiter=",", header=head + ",supply", comments=""
        )


@pytest.mark.repeat
def test_a_supply_dependent_gyro_is_identified_on_request(case, tmp_path):
    shift = np.array([0.02, -0.015, 0.025])
    supplied(case, shift)
    gap_run = run_gap(tmp_path / "out", case / "model.toml", case, "--candidates", "field")
    assert gap_run.names == [("gyro_supply", "left")]
    for axis, true in zip("xyz", shift, strict=True):
        value = gap_run.result["found"][0]["parameters"][axis]
        assert abs(value["value"] - true) < 3.0 * value["sigma"], axis


def test_a_falling_supply_without_effect_is_not_reported(case, tmp_path):
    supplied(case, np.zeros(3))
    gap_run = run_gap(tmp_path / "out", case / "model.toml", case, "--candidates", "field")
    assert gap_run.names == []
    assert "gyro_supply" not in " ".join(gap_run.result["warnings"])


def test_a_log_without_supply_cannot_show_supply_effects(foreign, tmp_path):
    asked = run_gap(tmp_path / "asked", foreign / "model.toml", foreign, "--candidates", "field")
    warnings = [line for line in asked.result["warnings"] if "gyro_supply" in line]
    assert len(warnings) == 2 and all("was not recorded" in line for line in warnings)
