"""What is simulated is what was asked for: times, rates, temperatures, noise, the path."""

from dataclasses import replace

import numpy as np
import pytest

from hubodo.effects import Noise
from hubodo.effects.gyro import GyroBias
from hubodo.effects.wheel import WheelCamber
from hubodo.errors import InputError
from hubodo.model import experiments
from hubodo.model.bench import ease
from hubodo.model.drive import Leg, integrate_path, loop_drive, random_drive, scripted_drive
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
def test_there_are_as_many_poses_as_fit(seconds, count):
    """Each rests for six seconds, and there are turns of 2.5 s between."""
    made = experiments.pose_experiment(seconds, np.random.default_rng(SEED), None)
    assert len(made.carried_motion.attitudes) == count
    assert count * 6.0 + (count - 1) * 2.5 <= seconds < (count + 1) * 6.0 + count * 2.5


def test_nine_poses_are_the_least():
    with pytest.raises(InputError, match="8 poses"):
        experiments.pose_experiment(73.9, np.random.default_rng(SEED), None)


def test_nodes_warm_up_evenly_or_as_they_are_told():
    t = np.array([0.0, 5.0, 12.5, 20.0])
    even = experiments.with_temperature(circle(), 20.0, 30.0, None).inputs
    np.testing.assert_allclose(even.temperature.at(t), 20.0 + t / 2.0, atol=1e-12)
    settling = experiments.with_temperature(circle(), 20.0, 30.0, 4.0).inputs
    wanted = 30.0 - 10.0 * np.exp(-settling.temperature.t / 4.0)
    np.testing.assert_allclose(settling.temperature.values, wanted, atol=1e-12)
    assert np.diff(settling.temperature.t).max() <= 1.0


def test_rates_and_noise_are_those_that_were_asked_for():
    made = experiments.simulate(
        model(speed_noise=0.05, yaw_rate_noise=0.002), circle(), rate=125.0, reference_rate=50.0, seed=SEED
    )
    for name in ("left", "frame"):
        np.testing.assert_allclose(np.diff(made.nodes[name].t), 1 / 125.0, atol=2e-9)
        assert made.nodes[name].t[-1] == pytest.approx(20.0 - 1 / 125.0)
    reference = made.reference
    assert len(reference) == 1000
    # A standard deviation of 1000 draws is known to 2.2 %; four of these.
    assert np.std(reference["speed"] - 2.0) == pytest.approx(0.05, rel=0.09)
    assert np.std(reference["yaw_rate"] - 0.25) == pytest.approx(0.002, rel=0.09)
    assert abs(np.mean(reference["speed"]) - 2.0) < 4 * 0.05 / 1000**0.5


def test_noise_of_the_reference_is_drawn_for_itself_by_the_seed():
    """So that the draw of a seed stays what it is, whatever nodes there are."""
    rng = np.random.default_rng([SEED, 0, *b"reference"])
    made = experiments.simulate_reference(model(speed_noise=0.05, yaw_rate_noise=0.002), circle(), 50.0, SEED)
    for name, value, sigma in (("speed", 2.0, 0.05), ("yaw_rate", 0.25, 0.002)):
        np.testing.assert_allclose(made[name], value + sigma * rng.standard_normal(1000), rtol=1e-12)


PARTS = np.linspace(0.0, 30.0, 7)


def made_of(kind, told=None, **options):
    return experiments.make_experiment(kind, told or model(), 30.0, SEED, **options)


def speeds(inputs):
    return inputs.speed(PARTS), inputs.yaw_rate(PARTS)


def test_each_kind_of_experiment_is_what_it_is_called():
    rest = made_of("rest")
    assert not np.any(speeds(rest.inputs)) and rest.has_path and rest.duration == 30.0
    for kind, drawn in (
        ("random", lambda rng: random_drive(rng, 30.0)),
        ("loop", lambda rng: loop_drive(rng, rest_time=1.0, driving_time=25.0)),
    ):
        found, wanted = made_of(kind), drawn(np.random.default_rng([SEED, 1]))
        assert found.has_path and found.duration == pytest.approx(30.0, abs=0.011)
        np.testing.assert_array_equal(speeds(found.inputs), speeds(wanted))
        assert np.abs(speeds(found.inputs)[0]).max() > 0.1
    earth = EarthRotation(0.8, 0.1)
    turned = made_of("turntable", earth=earth)
    assert (
        turned.on_bench and not turned.has_path and turned.table is not None and turned.carried_motion is None
    )
    assert turned.inputs.earth is earth
    carried = experiments.make_experiment("poses", model(), 80.0, SEED, earth=earth)
    assert carried.on_bench and not carried.has_path and carried.carried_motion.latitude == 0.8
    assert not np.any(speeds(carried.inputs))
    assert experiments.make_experiment("poses", model(), 80.0, SEED).carried_motion.latitude is None
    driven = circle(30.0).inputs
    assert made_of("my own", driven=driven).inputs is driven
    with pytest.raises(InputError, match="choose from"):
        made_of("nothing")


def test_inputs_that_the_model_gives_as_numbers_take_the_place_of_those_driven():
    drive = speeds(made_of("random").inputs)
    for names in ({"speed": 1.5}, {"yaw_rate": -0.2}, {"speed": 1.5, "yaw_rate": -0.2}):
        found = speeds(made_of("random", model(**names)).inputs)
        for key, one, before in zip(("speed", "yaw_rate"), found, drive, strict=True):
            expected = np.full(len(PARTS), names[key]) if key in names else before
            np.testing.assert_allclose(one, expected, rtol=1e-12)


def test_temperature_and_supply_are_those_that_were_asked_for_and_else_the_usual():
    usual = made_of("rest").inputs
    one = made_of("rest", temperature=[35.0], supply=[3.3]).inputs
    two = made_of("rest", temperature=[20.0, 35.0], supply=[4.2, 3.3]).inputs
    share = PARTS / 30.0
    for found, temperature, supply in (
        (usual, np.full(7, 25.0), usual.supply.at(PARTS)),
        (one, np.full(7, 35.0), np.full(7, 3.3)),
        (two, 20.0 + 15.0 * share, 4.2 - 0.9 * share),
    ):
        np.testing.assert_allclose(found.temperature.at(PARTS), temperature)
        np.testing.assert_allclose(found.supply.at(PARTS), supply)
    for options, told in (({}, False), ({"supply": [4.2, 3.3]}, True)):
        nodes = experiments.simulate(model(), made_of("rest", **options), 20.0, 10.0, SEED).nodes
        assert all(("supply" in node.columns) == told for node in nodes.values())
    np.testing.assert_allclose(nodes["left"]["supply"], 4.2 - 0.9 * nodes["left"].t / 30.0)


def test_on_a_bench_nodes_have_their_own_effects_only_and_begin_along_its_axes():
    lone = replace(
        model(), effects=(ScopedEffect(GyroBias(z=0.01), "left"), ScopedEffect(WheelCamber(0.1), "left"))
    )
    bench, road = made_of("turntable"), made_of("random")
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
    made = experiments.simulate_reference(names, circle(), 50.0, SEED)
    np.testing.assert_allclose(made["speed"], 2.0, rtol=1e-12)
    np.testing.assert_allclose(made["yaw_rate"], 0.25, rtol=1e-12)


def test_the_truth_of_a_circle_is_a_circle():
    made = experiments.true_path(circle())
    t = made.t
    np.testing.assert_allclose(t, np.arange(401) / 20.0, atol=1e-9)
    np.testing.assert_allclose(made["heading"], 0.25 * t, atol=1e-9)
    np.testing.assert_allclose(made["x"], 8.0 * np.sin(0.25 * t), atol=1e-7)
    np.testing.assert_allclose(made["y"], 8.0 * (1.0 - np.cos(0.25 * t)), atol=1e-7)


def test_a_turn_is_eased_with_the_derivatives_that_it_says():
    """Held against differences; at rest at both ends, and beyond them."""
    share = np.linspace(-0.2, 1.2, 1401)
    value, first, second = ease(share)
    np.testing.assert_allclose(np.gradient(value, share)[2:-2], first[2:-2], atol=1e-5)
    np.testing.assert_allclose(np.gradient(first, share)[2:-2], second[2:-2], atol=0.07)
    inner = (share > 0.01) & (share < 0.99)
    np.testing.assert_allclose(np.gradient(first, share)[inner], second[inner], atol=1e-4)
    assert value[0] == 0.0
    assert value[-1] == 1.0
    assert not first[[0, -1]].any()


def test_a_scripted_drive_goes_through_the_middle_of_its_legs():
    drive = scripted_drive([Leg(5.0, 0.0), Leg(6.0, 1.5, 0.2), Leg(4.0, -0.5, 0.0)])
    assert drive.speed.end == pytest.approx(15.0)
    middle = np.array([2.5, 8.0, 13.0])
    np.testing.assert_allclose(drive.speed(middle), [0.0, 1.5, -0.5], atol=1e-6)
    np.testing.assert_allclose(drive.yaw_rate(middle), [0.0, 0.2, 0.0], atol=1e-6)
    # Rounded by a Gaussian of 0.4 s: 16 % of the step is left one of its widths before the edge.
    np.testing.assert_allclose(
        drive.speed(np.array([5.0 - 0.4, 5.0, 5.0 + 0.4])), 1.5 * np.array([0.159, 0.5, 0.841]), atol=0.02
    )
    with pytest.raises(ValueError, match="positive duration"):
        scripted_drive([Leg(0.0, 1.0)])


@pytest.mark.parametrize("durations", [(), (0.0, 5.0), (5.0, -1.0), (0.0, 0.0)])
def test_a_drive_without_legs_or_with_one_that_takes_no_time_is_refused(durations):
    with pytest.raises(ValueError, match="positive duration"):
        scripted_drive([Leg(duration, 1.0) for duration in durations])


@pytest.mark.parametrize("seed", range(SEED, SEED + 8))
def test_random_drives_keep_to_their_limits_and_rest_at_both_ends(seed):
    drive = random_drive(np.random.default_rng(seed), 60.0, max_speed=2.5)
    t = np.linspace(0.0, 60.0, 6001)
    speed, yaw_rate = drive.speed(t), drive.yaw_rate(t)
    assert drive.speed.end == pytest.approx(60.0, abs=0.011)
    assert np.abs(speed).max() <= 2.5 + 1e-6
    assert np.abs(yaw_rate).max() <= 1.2 + 1e-6
    assert np.abs(speed[[0, -1]]).max() < 1e-3
    assert speed.max() > 0.7


@pytest.mark.parametrize("seed", range(SEED, SEED + 8))
def test_a_loop_comes_round_about_once(seed):
    drive = loop_drive(np.random.default_rng(seed))
    assert drive.speed.end == pytest.approx(8.0 + 60.0 + 4.0, abs=0.011)
    _, _, _, heading = integrate_path(drive)
    # Some ten legs, each up to 0.1 rad/s off for some 6 s: 1.2 rad, 1 sigma at the most.
    assert heading[-1] == pytest.approx(2.0 * np.pi, abs=3.6)
