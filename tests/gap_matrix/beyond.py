"""Effects outside the vocabulary that `gap --scaffold` has to find: their readings and their true formulas.

Each is added to the ideal readings of a node before the noise, at a size of a given gain in nats; a slip of
the clock changes the time stamps instead. `truth` has the parameter names that a scaffolded effect can have.
A lean to the left reads +az on a node facing left and -az on one facing right.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gap_matrix import cases, sensor
from gap_matrix.cases import Setup
from gap_matrix.channels import facing_sign, interpolate, stack_channels
from gap_matrix.dose import GainMeter
from gap_matrix.effects import SIDES
from gap_matrix.world import Array, IdealReadings, differentiate

CLOCK_SLIP_S = 0.004


@dataclass(frozen=True)
class UnlistedEffect:
    """A hidden effect outside the vocabulary.

    node: name of the node that has it, or `all`
    records: simulated records of both nodes
    truth: true values of the parameters that describe it
    """

    name: str
    node: str
    records: Mapping[str, sensor.Record]
    truth: Mapping[str, float]


@dataclass(frozen=True)
class UnitEffect:
    """An effect at unit size.

    added: (n, 6) change of the readings
    truth: amplitudes at unit size
    fixed_parameters: parameters that do not scale with the size
    """

    added: Array
    truth: Mapping[str, float]
    fixed_parameters: Mapping[str, float]


DrawFunction = Callable[[np.random.Generator, Setup, IdealReadings, Array], UnitEffect]


def hide_effect(setup: Setup, name: str, nats: float) -> UnlistedEffect:
    """Return an effect with parameters drawn by the seed, scaled to a gain in nats.

    Raises KeyError if the name is not one of EFFECT_NAMES.
    """
    rng = np.random.default_rng((setup.seed, 9, *name.encode()))
    node = str(rng.choice(SIDES))
    if name == "slipping_clock":
        return _slipping_clock(rng, setup, node)
    meter, draw_unit = GainMeter(setup), KINDS[name]
    unit = draw_unit(
        rng, setup, cases.compute_node_readings(setup, node, setup.known), setup.sample_times[node]
    )
    scale = float(np.sqrt(nats / meter.gain_of_difference(node, unit.added)))
    records = {
        side: cases.simulate_node_record(setup, side, [], scale * unit.added if side == node else 0.0)
        for side in SIDES
    }
    truth = {key: scale * value for key, value in unit.truth.items()} | dict(unit.fixed_parameters)
    return UnlistedEffect(name, node, records, truth)


def _steered_wheel(rng, setup, ideal, sample_times) -> UnitEffect:
    """Return a steered wheel: it turns about the vertical by the curvature of the path, v r / (v² + 1/4)."""
    speed, yaw_rate = ideal.motion.speed, ideal.motion.yaw_rate
    rate = differentiate(speed * yaw_rate / (speed**2 + 0.25), ideal.motion.step)
    rate, cosine, sine = interpolate(ideal, sample_times, rate, np.cos(ideal.angle), np.sin(ideal.angle))
    return UnitEffect(
        stack_channels(gx=rate * cosine, gy=-facing_sign(ideal) * rate * sine), {"yaw": 1.0}, {}
    )


def _unbalanced_wheel(rng, setup, ideal, sample_times) -> UnitEffect:
    """Return an unbalanced wheel: a vertical force once per revolution, proportional to spin²."""
    phase = rng.uniform(-np.pi, np.pi)
    spin = differentiate(ideal.angle, ideal.motion.step)
    hop_term, cosine, sine = interpolate(
        ideal, sample_times, spin**2 * np.cos(ideal.angle - phase), np.cos(ideal.angle), np.sin(ideal.angle)
    )
    truth = {"up_cos": np.cos(phase), "up_sin": np.sin(phase)}
    return UnitEffect(
        stack_channels(ax=hop_term * cosine, ay=-facing_sign(ideal) * hop_term * sine), truth, {}
    )


def _supply_ripple(rng, setup, ideal, sample_times) -> UnitEffect:
    """Return a supply ripple: a tone of fixed frequency on one gyro axis across the axle."""
    frequency, phase, axis = rng.uniform(3.0, 30.0), rng.uniform(-np.pi, np.pi), str(rng.choice(["gx", "gy"]))
    tone_term = np.cos(2.0 * np.pi * frequency * sample_times - phase)
    truth = {f"{axis}_cos": np.cos(phase), f"{axis}_sin": np.sin(phase)}
    return UnitEffect(stack_channels(**{axis: tone_term}), truth, {"frequency": frequency})


def _bent_axle(rng, setup, ideal, sample_times) -> UnitEffect:
    """Return a bent axle: a lateral force on the hub once per revolution, proportional to spin²."""
    phase = rng.uniform(-np.pi, np.pi)
    (push_term,) = interpolate(
        ideal, sample_times, differentiate(ideal.angle, ideal.motion.step) ** 2 * np.cos(ideal.angle - phase)
    )
    facing = facing_sign(ideal)
    left = {"left_cos": np.cos(phase), "left_sin": np.sin(phase)}
    own = {"az_cos": facing * np.cos(phase), "az_sin": facing * np.sin(phase)}
    return UnitEffect(stack_channels(az=facing * push_term), {**left, **own}, {})


def _flat_spot(rng, setup, ideal, sample_times) -> UnitEffect:
    """Return a flat spot: an upward impulse when one spot of the tyre touches the road, as spin²."""
    position, width = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.1, 0.25)
    spin, cosine, sine = interpolate(
        ideal,
        sample_times,
        differentiate(ideal.angle, ideal.motion.step),
        np.cos(ideal.angle),
        np.sin(ideal.angle),
    )
    offset = np.arctan2(
        sine * np.cos(position) - cosine * np.sin(position),
        cosine * np.cos(position) + sine * np.sin(position),
    )
    kick_term = spin**2 * np.exp(-0.5 * (offset / width) ** 2)
    return UnitEffect(
        stack_channels(ax=kick_term * cosine, ay=-facing_sign(ideal) * kick_term * sine),
        {"up": 1.0},
        {"place": position, "width": width},
    )


def _cross_talk(rng, setup, ideal, sample_times) -> UnitEffect:
    """Return cross talk: a gyro axis across the axle picks up the spin rate of the other wheel."""
    axis = str(rng.choice(["gx", "gy"]))
    # The spin rates of both wheels sum to twice that of the body centre.
    spin = 2.0 * ideal.motion.speed / setup.radius - differentiate(ideal.angle, ideal.motion.step)
    (spin,) = interpolate(ideal, sample_times, spin)
    return UnitEffect(stack_channels(**{axis: spin}), {axis: 1.0}, {})


def _magnet(rng, setup, ideal, sample_times) -> UnitEffect:
    """Return a magnet on the frame: a gyro axis across the axle is disturbed once per revolution."""
    phase, axis = rng.uniform(-np.pi, np.pi), str(rng.choice(["gx", "gy"]))
    (once_per_revolution,) = interpolate(ideal, sample_times, np.cos(ideal.angle - phase))
    return UnitEffect(
        stack_channels(**{axis: once_per_revolution}),
        {f"{axis}_cos": np.cos(phase), f"{axis}_sin": np.sin(phase)},
        {},
    )


KINDS: Mapping[str, DrawFunction] = {
    "steered_wheel": _steered_wheel,
    "unbalanced_wheel": _unbalanced_wheel,
    "supply_ripple": _supply_ripple,
    "bent_axle": _bent_axle,
    "tyre_flat_spot": _flat_spot,
    "cross_talk": _cross_talk,
    "magnet": _magnet,
}
EFFECT_NAMES = (*KINDS, "slipping_clock")


def _slipping_clock(rng, setup: Setup, node: str) -> UnlistedEffect:
    """Return a clock slip: from a random time on, the stamps of a node are shifted by CLOCK_SLIP_S."""
    slip_time = float(rng.uniform(0.35, 0.65) * setup.drive.duration)
    delay = CLOCK_SLIP_S * float(rng.choice([-1.0, 1.0]))
    records = {side: cases.simulate_node_record(setup, side, []) for side in SIDES}
    t = records[node].t
    records[node] = replace(records[node], t=t + delay * (t >= slip_time))
    return UnlistedEffect("slipping_clock", node, records, {"delay": delay, "since": slip_time})
