"""Simulated recordings have the requested times, rates, temperatures, noise and path."""

from dataclasses import replace

import numpy as np
import pytest

from hubodo.effects import Noise
from hubodo.effects.gyro import GyroBias
from hubodo.effects.wheel import WheelCamber
from hubodo.errors import InputError
from hubodo.model import experiments
from hubodo.model.drive import loop_drive, random_drive
from hubodo.model.experiments import Experiment
from hubodo.model.forward import NodeInitialState
from hubodo.model.inputs import EarthRotation, MotionInputs
from hubodo.model.model_file import InputSources, Model, ScopedEffect
from hubodo.smoothing_spline import constant_spline
from hubodo.vehicle import NodeMount, Vehicle

SEED = 411


def model(**inputs):
    vehicle = Vehicle(0.3, 0.9, {"left": NodeMount("left", "left"), "frame": NodeMount()})
    return Model(vehicle, Noise(0.004, 0.05), InputSources(**inputs))


def circle(duration=20.0, speed=2.0, yaw_rate=0.25):
    return Experiment(
        "drive", MotionInputs(constant_spline(speed, 0.0, duration), constant_spline(yaw_rate, 0.0, duration))
    )


@pytest.mark.parametrize(("seconds", "count"), [(74.0, 9), (84.0, 10), (100.0, 12)])
def test_the_number_of_poses_follows_from_the_duration(seconds, count):
    """Each pose lasts six seconds, with turns of 2.5 s in between."""
    result = experiments.pose_experiment(seconds, np.random.default_rng(SEED), None)
    assert len(result.carried_motion.attitudes) == count
    assert count * 6.0 + (count - 1) * 2.5 <= seconds < (count + 1) * 6.0 + count * 2.5


def test_fewer_than_nine_poses_are_refused():
    with pytest.raises(InputError, match="8 poses"):
        experiments.pose_experiment(73.9, np.random.default_rng(SEED), None)


def test_node_temperatures_are_linear_or_exponential():
    t = np.array([0.0, 5.0, 12.5, 20.0])
    even = experiments.with_temperature(circle(), 20.0, 30.0, None).inputs
    np.testing.assert_allclose(even.temperature.at(t), 20.0 + t / 2.0, atol=1e-12)
    settling = experiments.with_temperature(circle(), 20.0, 30.0, 4.0).inputs
    wanted = 30.0 - 10.0 * np.exp(-settling.temperature.t / 4.0)
    np.testing.assert_allclose(settling.temperature.values, wanted, atol=1e-12)
    assert np.diff(settling.temperature.t).max() <= 1.0


def test_rates_and_noise_are_those_requested():
    result = experiments.simulate(
        model(speed_noise=0.05, yaw_rate_noise=0.002), circle(), rate=125.0, reference_rate=50.0, seed=SEED
    )
    for name in ("left", "frame"):
        np.testing.assert_allclose(np.diff(result.nodes[name].t), 1 / 125.0, atol=2e-9)
        assert result.nodes[name].t[-1] == pytest.approx(20.0 - 1 / 125.0)
    reference = result.reference
    assert len(reference) == 1000
    # A standard deviation of 1000 draws is known to 2.2 %; the tolerance is four of these.
    assert np.std(reference["speed"] - 2.0) == pytest.approx(0.05, rel=0.09)
    assert np.std(reference["yaw_rate"] - 0.25) == pytest.approx(0.002, rel=0.09)
    assert abs(np.mean(reference["speed"]) - 2.0) < 4 * 0.05 / 1000**0.5


def test_noise_of_the_reference_depends_on_the_seed_only():
    """The draw of a seed must not depend on the nodes of the vehicle."""
    rng = np.random.default_rng([SEED, 0, *b"reference"])
    result = experiments.simulate_reference(
        model(speed_noise=0.05, yaw_rate_noise=0.002), circle(), 50.0, SEED
    )
    for name, value, sigma in (("speed", 2.0, 0.05), ("yaw_rate", 0.25, 0.002)):
        np.testing.assert_allclose(result[name], value + sigma * rng.standard_normal(1000), rtol=1e-12)


PARTS = np.linspace(0.0, 30.0, 7)


def experiment_of_kind(kind, has_supply=None, **options):
    return experiments.make_experiment(kind, has_supply or model(), 30.0, SEED, **options)


def speeds(inputs):
    return inputs.speed(PARTS), inputs.yaw_rate(PARTS)


def test_each_kind_of_experiment_has_its_motion():
    standstill = experiment_of_kind("rest")
    assert not np.any(speeds(standstill.inputs)) and standstill.has_path and standstill.duration == 30.0
    for kind, drawn in (
        ("random", lambda rng: random_drive(rng, 30.0)),
        ("loop", lambda rng: loop_drive(rng, rest_time=1.0, driving_time=25.0)),
    ):
        observed, wanted = experiment_of_kind(kind), drawn(np.random.default_rng([SEED, 1]))
        assert observed.has_path and observed.duration == pytest.approx(30.0, abs=0.011)
        np.testing.assert_array_equal(speeds(observed.inputs), speeds(wanted))
        assert np.abs(speeds(observed.inputs)[0]).max() > 0.1
    earth = EarthRotation(0.8, 0.1)
    turned = experiment_of_kind("turntable", earth=earth)
    assert (
        turned.on_bench and not turned.has_path and turned.table is not None and turned.carried_motion is None
    )
    assert turned.inputs.earth is earth
    carried = experiments.make_experiment("poses", model(), 80.0, SEED, earth=earth)
    assert carried.on_bench and not carried.has_path and carried.carried_motion.latitude == 0.8
    assert not np.any(speeds(carried.inputs))
    assert experiments.make_experiment("poses", model(), 80.0, SEED).carried_motion.latitude is None
    driven = circle(30.0).inputs
    assert experiment_of_kind("my own", driven=driven).inputs is driven
    with pytest.raises(InputError, match="choose from"):
        experiment_of_kind("nothing")


def test_constant_inputs_of_the_model_replace_those_of_the_drive():
    drive = speeds(experiment_of_kind("random").inputs)
    for names in ({"speed": 1.5}, {"yaw_rate": -0.2}, {"speed": 1.5, "yaw_rate": -0.2}):
        observed = speeds(experiment_of_kind("random", model(**names)).inputs)
        for key, one, before in zip(("speed", "yaw_rate"), observed, drive, strict=True):
            expected = np.full(len(PARTS), names[key]) if key in names else before
            np.testing.assert_allclose(one, expected, rtol=1e-12)


def test_temperature_and_supply_are_those_requested_or_the_reference_values():
    usual = experiment_of_kind("rest").inputs
    one = experiment_of_kind("rest", temperature=[35.0], supply=[3.3]).inputs
    two = experiment_of_kind("rest", temperature=[20.0, 35.0], supply=[4.2, 3.3]).inputs
    share = PARTS / 30.0
    for observed, temperature, supply in (
        (usual, np.full(7, 25.0), usual.supply.at(PARTS)),
        (one, np.full(7, 35.0), np.full(7, 3.3)),
        (two, 20.0 + 15.0 * share, 4.2 - 0.9 * share),
    ):
        np.testing.assert_allclose(observed.temperature.at(PARTS), temperature)
        np.testing.assert_allclose(observed.supply.at(PARTS), supply)
    for options, has_supply in (({}, False), ({"supply": [4.2, 3.3]}, True)):
        nodes = experiments.simulate(model(), experiment_of_kind("rest", **options), 20.0, 10.0, SEED).nodes
        assert all(("supply" in node.columns) == has_supply for node in nodes.values())
    np.testing.assert_allclose(nodes["left"]["supply"], 4.2 - 0.9 * nodes["left"].t / 30.0)


def test_on_a_bench_nodes_have_effects_of_nodes_only_and_start_along_its_axes():
    lone = replace(
        model(), effects=(ScopedEffect(GyroBias(z=0.01), "left"), ScopedEffect(WheelCamber(0.1), "left"))
    )
    bench, road = experiment_of_kind("turntable"), experiment_of_kind("random")
    kinds = [
        {type(effect) for effect in experiments.node_effects(lone, "left", where)} for where in (bench, road)
    ]
    assert kinds == [{GyroBias}, {GyroBias, WheelCamber}]
    starts = [experiments.initial_state(lone, "left", road, seed).wheel_angle for seed in range(60)]
    assert min(starts) < -2.5 and max(starts) > 2.5 and max(np.abs(starts)) <= np.pi
    for name, where in (("left", bench), ("frame", road)):
        assert experiments.initial_state(lone, name, where, SEED) == NodeInitialState()


def test_an_input_that_is_a_node_has_no_noise_of_its_own():
    names = model(speed="nodes.left.gz", yaw_rate=0.25, speed_noise=0.05, yaw_rate_noise=0.002)
    result = experiments.simulate_reference(names, circle(), 50.0, SEED)
    np.testing.assert_allclose(result["speed"], 2.0, rtol=1e-12)
    np.testing.assert_allclose(result["yaw_rate"], 0.25, rtol=1e-12)


def test_the_true_path_of_a_circle_is_a_circle():
    result = experiments.true_path(circle())
    t = result.t
    np.testing.assert_allclose(t, np.arange(401) / 20.0, atol=1e-9)
    np.testing.assert_allclose(result["heading"], 0.25 * t, atol=1e-9)
    np.testing.assert_allclose(result["x"], 8.0 * np.sin(0.25 * t), atol=1e-7)
    np.testing.assert_allclose(result["y"], 8.0 * (1.0 - np.cos(0.25 * t)), atol=1e-7)
