"""How states and covariance go through a window: beside arcs, differences, and the noise that is declared."""

from __future__ import annotations

import cmath
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import (
    CAMBER,
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    HEADING,
    RATE_BEYOND_RANGE,
    SLOPE,
    SPEED,
    TIME_OFFSET,
    WHEEL_ANGLE,
    YAW_RATE,
    X,
    Y,
)
from hubodo.fuse.wheel.initial_state import InitialState, initial_state
from hubodo.fuse.wheel.measurements import WindowNoise
from hubodo.fuse.wheel.motion_model import MotionModel
from hubodo.fuse.wheel.motion_prediction import MotionPrediction, detect_wheel_motion, vehicle_motion
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.outage_model import free_motion_variances, vehicle_agility
from hubodo.fuse.wheel.wheel import WheelMode
from hubodo.fuse.wheel.window import EMPTY_WINDOW, WINDOW_S, Window

T, G = WINDOW_S, STANDARD_GRAVITY
FASTEST = 1.0
Pairs = tuple[tuple[Any, Window], ...]


def vehicle(*names: str) -> tuple[WheelConfig, InitialState, Pairs]:
    """Wheels whose angles are known, each in a window of its own."""
    nodes = {name: WheelNode(name, "left") for name in names}  # type: ignore[arg-type]
    config = WheelConfig(0.2, 0.6, nodes, position_aided=True)
    begin = initial_state(config)
    windows = []
    for number, wheel in enumerate(begin.wheels):
        wheel.angle_initialised = True
        rate = 6.0 + number
        windows.append(
            Window(
                spin=rate * T,
                rate_start=rate - 0.1,
                rate_end=rate + 0.15,
                carrier=0.098 + 0.001j,
                force=T * (9.7 + 1j * (0.7 + 0.4 * number)) * cmath.exp(-0.5j * rate * T),
                lever=0.5 - 3.5j,
                axial_variance=0.3,
            )
        )
    return config, begin, tuple(zip(begin.wheels, windows, strict=True))


def somewhere(begin: InitialState, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """States away from zero, and a covariance in which all has to do with all."""
    rng = np.random.default_rng(seed)
    size = begin.columns.size
    root = rng.standard_normal((size, size)) / np.sqrt(size)
    return 0.05 * rng.standard_normal(size), root @ root.T


def changed(pairs: Pairs, **flags: float) -> Pairs:
    return tuple((wheel, window._replace(**flags)) for wheel, window in pairs)


BOTH = ("left", "right")


@pytest.mark.parametrize("names", [BOTH, ("right",)])
@pytest.mark.parametrize(("speed", "yaw_rate"), [(3.0, 2.0), (-3.0, 2.0), (1.0, -0.5)])
@pytest.mark.parametrize("clipped", [0.0, 1.0])
def test_a_vehicle_goes_along_an_arc_and_its_wheels_turn_by_what_their_gyros_show(
    names: tuple[str, ...], speed: float, yaw_rate: float, clipped: float
) -> None:
    config, begin, pairs = vehicle(*names)
    pairs = changed(pairs, spin_clipped=clipped)
    before, p = somewhere(begin, 5)
    at = begin.columns.vehicle
    before[at[SPEED]], before[at[YAW_RATE]], before[at[HEADING]] = speed, yaw_rate, 0.7
    for wheel in begin.wheels:
        before[wheel.columns[CAMBER]] = 0.2
    x = before.tolist()
    MotionModel(config, begin).advance(x, p, pairs)
    expected = before.copy()
    end = 0.7 + yaw_rate * T
    expected[at[HEADING]] = end
    # To the fourth order of the angle of the arc, 0.2 rad.
    expected[at[X]] += speed / yaw_rate * (math.sin(end) - math.sin(0.7))
    expected[at[Y]] -= speed / yaw_rate * (math.cos(end) - math.cos(0.7))
    for entry, place in at.items():
        expected[place] *= math.exp(-T / entry.correlation_time)
    for wheel, window in pairs:
        own = {entry: before[place] for entry, place in wheel.columns.items()}
        rate = window.spin / T
        if not clipped:
            rate = (rate - own[GYRO_BIAS_Z]) / (1.0 + own[GYRO_SCALE_Z])
        rate += own[RATE_BEYOND_RANGE] - wheel.geometry.side * yaw_rate * math.sin(0.2)
        expected[wheel.columns[WHEEL_ANGLE]] += rate * T
    assert x == pytest.approx(expected, abs=3e-7)


def test_a_wheel_angle_stays_within_half_a_turn() -> None:
    config, begin, pairs = vehicle("left")
    x, place = list(begin.x), begin.wheels[0].columns[WHEEL_ANGLE]
    x[place] = 3.0
    MotionModel(config, begin).advance(x, begin.p, pairs)
    assert x[place] == pytest.approx(3.0 + 0.6 - 2.0 * math.pi)


@pytest.mark.parametrize("names", [BOTH, ("right",)])
@pytest.mark.parametrize("clipped", [0.0, 1.0])
def test_the_transition_of_a_window_is_the_derivative_of_the_motion(
    names: tuple[str, ...], clipped: float
) -> None:
    config, begin, pairs = vehicle(*names)
    pairs = changed(pairs, spin_clipped=clipped)
    before, p = somewhere(begin, 6)
    at = begin.columns.vehicle
    before[at[SPEED]], before[at[YAW_RATE]], before[at[HEADING]] = 3.0, 0.1, 0.7
    motion = MotionModel(config, begin)

    def after(x: np.ndarray) -> np.ndarray:
        made = x.tolist()
        motion.advance(made, p.copy(), pairs)
        return np.array(made)

    step = 1e-5
    numeric = [
        (after(before + step * unit) - after(before - step * unit)) / (2.0 * step)
        for unit in np.eye(len(before))
    ]
    after(before)
    # That a chord of a bend is shorter is left out of what the yaw rate does to it: v T² (r T) / 12.
    np.testing.assert_allclose(motion.transition(), np.array(numeric).T, atol=3e-5)


@pytest.mark.parametrize("names", [BOTH, ("right",)])
@pytest.mark.parametrize("speed", [3.0, -3.0])
@pytest.mark.parametrize(("missing", "gyro"), [(0.0, 0.0), (0.0, 4e-4), (0.3, 0.0)])
def test_the_covariance_goes_through_a_window_as_the_transition_says_and_by_what_is_random_in_it(
    names: tuple[str, ...], speed: float, missing: float, gyro: float
) -> None:
    """What wanders; 1 mm for a metre across the way; the noise of gyros; a rad/s where nothing is heard."""
    config, begin, pairs = vehicle(*names)
    pairs = changed(pairs, missing=missing)
    before, p = somewhere(begin, 7)
    at = begin.columns.vehicle
    before[at[SPEED]], before[at[YAW_RATE]], before[at[HEADING]] = speed, 0.5, 0.7
    for wheel in begin.wheels:
        wheel.standstill.noise = gyro
    motion, found = MotionModel(config, begin), p.copy()
    for number in range(2):
        x = before.tolist()
        motion.advance(x, found, pairs)
        if number == 0:
            first = found.copy()
    f = motion.transition()
    noise = np.zeros_like(p)
    for wheel in begin.wheels:
        for entry, place in wheel.columns.items():
            if entry is TIME_OFFSET and len(names) == 1:
                continue
            lasting = math.isinf(entry.correlation_time)
            noise[place, place] = (
                entry.random_walk**2 * T
                if lasting
                else entry.prior**2 * -math.expm1(-2.0 * T / entry.correlation_time)
            )
        angle = wheel.columns[WHEEL_ANGLE]
        noise[angle, angle] = max(config.noise.gyro**2 * T, gyro * T * T) + (missing * T) ** 2
    across = np.array([-math.sin(0.7 + 0.025), math.cos(0.7 + 0.025)])
    places = [at[X], at[Y]]
    noise[np.ix_(places, places)] += 0.001**2 * abs(speed) * T * np.outer(across, across)
    np.testing.assert_allclose(first, f @ p @ f.T + noise, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(found, f @ first @ f.T + noise, rtol=1e-6, atol=1e-12)
    # So little is random that it would be lost beside what was not known.
    still = np.zeros_like(p)
    MotionModel(config, begin).advance(before.tolist(), still, pairs)
    np.testing.assert_allclose(still, noise, rtol=1e-3, atol=1e-20)


def predicted(
    pairs: Pairs,
    begin: InitialState,
    x: np.ndarray,
    p: np.ndarray,
    made: MotionPrediction | None = None,
    carry: bool = True,
    told: bool = False,
    stillness: MotionState = MotionState.MOVING,
) -> tuple[np.ndarray, np.ndarray, MotionPrediction]:
    """States and covariance after a window that is expected."""
    made = made or MotionPrediction(begin.columns, WindowNoise(WheelConfig(0.2, 0.6, {"a": LEFT}).noise, 0.2))
    after, p = x.tolist(), p.copy()
    made.predict(after, p, pairs, stillness, carry, told, FASTEST)
    return np.array(after), p, made


LEFT = WheelNode("left", "left")


def felt(wheel: Any, window: Window, x: np.ndarray) -> float:
    """m/s of forward force, less that of lever arm, bias and slope: the model of forward.py, written anew."""
    own = {f"{entry}": x[place] for entry, place in wheel.columns.items()}
    rate = (window.spin / T - own["gyro_bias.z"]) / (1.0 + own["gyro_scale_factor.z"]) + own[
        str(RATE_BEYOND_RANGE)
    ]
    rolls = rate - wheel.geometry.side * own[str(YAW_RATE)] * math.sin(own[str(CAMBER)])
    turn = cmath.exp(1j * (own[str(WHEEL_ANGLE)] + 0.5 * rolls * T))
    force = window.force - complex(own["accel_bias.x"], own["accel_bias.y"]) * window.carrier
    force -= complex(own["lever_arm.x"], own["lever_arm.y"]) * window.lever
    return (turn * force).imag - own[str(SLOPE)] * T


@pytest.mark.parametrize("names", [BOTH, ("right",)])
def test_a_speed_that_is_carried_gains_what_the_accelerometers_feel_with_all_that_this_owes(
    names: tuple[str, ...],
) -> None:
    config, begin, pairs = vehicle(*names)
    before, p = somewhere(begin, 8)
    speed, yaw_rate = begin.columns.vehicle[SPEED], begin.columns.vehicle[YAW_RATE]
    x, found, made = predicted(pairs, begin, before, p)
    gain = np.mean([felt(*pair, before) for pair in pairs])
    assert abs(gain) < 0.5, "the hardest that is believed would hide it"
    assert x[speed] - before[speed] == pytest.approx(gain)
    assert np.delete(x - before, speed) == pytest.approx(0.0)

    def after(at: np.ndarray) -> float:
        return predicted(pairs, begin, at, p)[0][speed]

    slope = [(after(before + 1e-6 * u) - after(before - 1e-6 * u)) / 2e-6 for u in np.eye(len(before))]
    assert made.speed_row == pytest.approx(np.array(slope), abs=1e-7)
    f = np.eye(len(before))
    f[speed] = slope
    noise = config.noise
    white = noise.accel**2 * T + (noise.vibration_share * T) ** 2 * 0.3 + (noise.forward_force * T) ** 2
    expected = f @ p @ f.T
    expected[speed, speed] += white / len(pairs)
    expected[yaw_rate, yaw_rate] += 0.5**2
    np.testing.assert_allclose(found, expected, atol=1e-6)
    # Of two windows half of each.
    harder = changed(pairs, force=pairs[0][1].force + 0.02j)
    x, _, made = predicted(harder, begin, before, p, made)
    second = np.mean([felt(*pair, before) for pair in harder])
    assert x[speed] - before[speed] == pytest.approx(0.5 * (gain + second))
    made.clear_force()
    x, *_ = predicted(harder, begin, before, p, made)
    assert x[speed] - before[speed] == pytest.approx(second)


@pytest.mark.parametrize("carry", [True, False])
@pytest.mark.parametrize("push", [80j, -80j])
def test_nobody_brakes_or_drives_harder_than_half_of_gravity(carry: bool, push: complex) -> None:
    _, begin, pairs = vehicle("left")
    speed = begin.columns.vehicle[SPEED]
    _, window = pairs[0]
    upright = changed(pairs, force=push * T * cmath.exp(-0.5j * window.spin), lever=0j)
    x, *_ = predicted(upright, begin, np.zeros(begin.columns.size), begin.p, carry=carry)
    assert x[speed] == pytest.approx(math.copysign(5.0, push.imag) * T)


def test_an_accelerometer_that_tells_nothing_has_no_part_in_a_carried_speed() -> None:
    _, begin, pairs = vehicle(*BOTH)
    before, p = somewhere(begin, 9)
    speed, yaw_rate = begin.columns.vehicle[SPEED], begin.columns.vehicle[YAW_RATE]
    alone = felt(*pairs[0], before)
    for unsound in ({"missing": 0.01}, {"force_clipped": 0.01}):
        mixed = (pairs[0], *changed(pairs[1:], **unsound))
        assert predicted(mixed, begin, before, p)[0][speed] - before[speed] == pytest.approx(alone)
        x, found, made = predicted(changed(pairs, **unsound), begin, before, p)
        assert x == pytest.approx(before) and made.speed_row is None
        assert found[speed, speed] == pytest.approx(p[speed, speed] + 0.5**2)
        assert found[yaw_rate, yaw_rate] == pytest.approx(p[yaw_rate, yaw_rate] + 0.5**2)
    for word, value in (("angle_initialised", False), ("best_mode", WheelMode.DISABLED)):
        usual = getattr(begin.wheels[1], word)
        setattr(begin.wheels[1], word, value)
        assert predicted(pairs, begin, before, p)[0][speed] - before[speed] == pytest.approx(alone)
        setattr(begin.wheels[1], word, usual)


def free(begin: InitialState, pairs: Pairs, **options: bool) -> tuple[float, float]:
    """What is added to the variances of speed and yaw rate."""
    size = begin.columns.size
    _, p, _ = predicted(pairs, begin, np.zeros(size), np.zeros((size, size)), **options)  # type: ignore[arg-type]
    added = p.diagonal()[[begin.columns.vehicle[SPEED], begin.columns.vehicle[YAW_RATE]]]
    assert p.sum() == pytest.approx(added.sum())
    return float(added[0]), float(added[1])


def test_speed_and_yaw_rate_are_free_where_they_are_seen_and_wander_where_they_are_not() -> None:
    _, begin, pairs = vehicle(*BOTH)
    wander = free_motion_variances(vehicle_agility(FASTEST))
    seen, gone = 0.25, Window(missing=0.5)
    assert max(wander) < 0.5 * seen
    one = (pairs[0], (begin.wheels[1], gone))
    none = tuple((wheel, gone) for wheel in begin.wheels)
    carried = {"carry": True, "told": False}
    for joined, heard, told, expected in (
        (True, pairs, False, (seen, seen)),
        (False, pairs, False, (seen, seen)),
        (True, one, False, (seen, seen)),
        (False, one, False, (seen, wander[1])),
        (False, one, True, (seen, seen)),
        (True, none, False, wander),
        (False, none, False, wander),
        (False, none, True, (seen, seen)),
    ):
        for wheel in begin.wheels:
            wheel.angle_initialised = joined
        assert free(begin, heard, carry=False, told=told) == pytest.approx(expected)
        if heard is not pairs:
            along, turning = free(begin, heard, **carried)
            assert turning == pytest.approx(seen if joined and heard is one else wander[1])
            # What an accelerometer tells is not free.
            assert (along == pytest.approx(seen)) != (joined and heard is one)


@pytest.mark.parametrize("names", [BOTH, ("left",)])
@pytest.mark.parametrize("clipped", [0.0, 1.0])
def test_a_speed_that_is_seen_goes_on_with_the_forward_force_that_is_felt(
    names: tuple[str, ...], clipped: float
) -> None:
    """In axes of the wheel at the middle of the window, less the slope: without lever arm and bias."""
    _, begin, pairs = vehicle(*names)
    pairs = changed(pairs, spin_clipped=clipped)
    before, p = somewhere(begin, 10)
    x, _, made = predicted(pairs, begin, before, p, carry=False)
    forces = []
    for wheel, window in pairs:
        rate = window.spin / T
        if not clipped:
            rate = (rate - before[wheel.columns[GYRO_BIAS_Z]]) / (1.0 + before[wheel.columns[GYRO_SCALE_Z]])
        rate += before[wheel.columns[RATE_BEYOND_RANGE]]
        angle = before[wheel.columns[WHEEL_ANGLE]] + 0.5 * rate * T
        forces.append((window.force * cmath.exp(1j * angle)).imag)
    at = begin.columns.vehicle
    gain = np.mean(forces) - before[at[SLOPE]] * T
    assert abs(gain) < 0.5
    assert x[at[SPEED]] - before[at[SPEED]] == pytest.approx(gain)
    assert made.speed_row is None and made.reset_states == []


@pytest.mark.parametrize(
    ("stillness", "sigmas"), [(MotionState.STANDSTILL, (1e-3, 1e-4)), (MotionState.ROCKING, (0.03, 0.03))]
)
def test_a_vehicle_that_stands_has_no_speed_and_knows_nothing_of_the_one_before(
    stillness: MotionState, sigmas: tuple[float, float]
) -> None:
    _, begin, pairs = vehicle(*BOTH)
    before, p = somewhere(begin, 11)
    places = [begin.columns.vehicle[SPEED], begin.columns.vehicle[YAW_RATE]]
    _, _, made = predicted(pairs, begin, before, p)
    x, found, made = predicted(pairs, begin, before, p, made, carry=False, stillness=stillness)
    expected, mean = p.copy(), before.copy()
    expected[places], expected[:, places], mean[places] = 0.0, 0.0, 0.0
    expected[places, places] = np.square(sigmas)
    np.testing.assert_allclose(found, expected)
    assert x == pytest.approx(mean)
    assert made.reset_states == places
    # What was felt before it stood is no part of what is felt after.
    harder = changed(pairs, force=pairs[0][1].force + 0.02j)
    gained = predicted(harder, begin, before, p, made)[0][places[0]] - before[places[0]]
    assert gained == pytest.approx(np.mean([felt(*pair, before) for pair in harder]))


def test_how_still_a_wheel_is_is_asked_with_its_biases_and_the_least_known_of_them() -> None:
    _, begin, pairs = vehicle(*BOTH)
    before, p = somewhere(begin, 12)
    for least in (GYRO_BIAS_X, GYRO_BIAS_Y, GYRO_BIAS_Z):
        asked = []
        for wheel in begin.wheels:
            wheel.standstill = SimpleNamespace(detect=lambda *args, seen=asked: seen.append(args) or args[1])  # type: ignore[assignment]
            for entry in (GYRO_BIAS_X, GYRO_BIAS_Y, GYRO_BIAS_Z):
                p[wheel.columns[entry], wheel.columns[entry]] = 0.04 if entry is least else 0.01
        told = detect_wheel_motion(pairs, before.tolist(), p)
        for (wheel, window), args, said in zip(pairs, asked, told, strict=True):
            bias = {entry: before[place] for entry, place in wheel.columns.items()}
            across = complex(bias[GYRO_BIAS_X], bias[GYRO_BIAS_Y])
            assert args == (window, said, across, pytest.approx(0.2)) and said == bias[GYRO_BIAS_Z]


def test_a_vehicle_is_as_still_as_its_wheel_that_is_least_and_not_lost() -> None:
    moving, rocking, resting = MotionState.MOVING, MotionState.ROCKING, MotionState.STANDSTILL
    assert vehicle_motion([resting, rocking], [False, False]) is rocking
    assert vehicle_motion([moving, resting], [True, False]) is resting
    assert vehicle_motion([moving, resting], [False, True]) is moving
    assert vehicle_motion([resting, resting], [True, True]) is moving
    assert EMPTY_WINDOW.missing == 1.0
