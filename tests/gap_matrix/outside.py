"""Eight effects outside the vocabulary, with the channels they change and the words that describe them.

Each is added to the ideal readings of one of the two nodes before the noise. Linear ones are scaled to a gain
in nats (`dose.GainMeter`); bit errors are a given number, since a single one gains thousands of nats.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gap_matrix import cases, sensor
from gap_matrix.cases import Setup
from gap_matrix.channels import CHANNELS, facing_sign, interpolate, stack_channels
from gap_matrix.dose import MEDIUM_NATS, STRONG_NATS, GainMeter
from gap_matrix.effects import SIDES
from gap_matrix.sensor import ACCEL_LSB, GYRO_LSB
from gap_matrix.world import Array, IdealReadings, differentiate

LSB = (GYRO_LSB,) * 3 + (ACCEL_LSB,) * 3
BIT_ERROR_COUNTS = {"medium": 10, "strong": 40}
NATS = {"medium": MEDIUM_NATS, "strong": STRONG_NATS}
# A channel shows an effect if it has at least this share of the energy of the strongest channel.
_VISIBLE_ENERGY_SHARE = 0.2


@dataclass(frozen=True)
class OutsideEffect:
    """A hidden effect outside the vocabulary.

    node: name of the node that has it
    size: multiple of its unit size, or number of bit errors
    gain: expected gain in nats
    added: (n, 6) change of the readings
    channels: channels that show it, such as `left.gx`
    expected_words: words of which a correct description of its dependence contains at least one
    """

    name: str
    node: str
    size: float
    gain: float
    added: Array
    channels: tuple[str, ...]
    expected_words: tuple[str, ...]


DrawFunction = Callable[[np.random.Generator, Setup, IdealReadings, Array], Array]


@dataclass(frozen=True)
class _Kind:
    """A kind of effect outside the vocabulary."""

    draw: DrawFunction  # returns the change (n, 6) of the readings at unit size
    expected_words: tuple[str, ...]


def hide_effect(setup: Setup, name: str, strength: str, meter: GainMeter | None = None) -> OutsideEffect:
    """Return an effect with parameters drawn by the seed, medium or strong.

    Raises KeyError if the name is not one of KINDS.
    """
    kind = KINDS[name]
    rng = np.random.default_rng((setup.seed, 8, *name.encode()))
    node = str(rng.choice(SIDES))
    ideal = cases.compute_node_readings(setup, node, setup.known)
    meter = meter or GainMeter(setup)
    sample_times = setup.sample_times[node]
    if name == "bit_error":
        added, size = (
            _bit_errors(rng, setup, node, ideal, BIT_ERROR_COUNTS[strength]),
            float(BIT_ERROR_COUNTS[strength]),
        )
    else:
        unit_change = kind.draw(rng, setup, ideal, sample_times)
        size = float(np.sqrt(NATS[strength] / meter.gain_of_difference(node, unit_change)))
        added = size * unit_change
    energy = meter.channel_energies(node, added)
    visible_channels = tuple(
        f"{node}.{CHANNELS[k]}" for k in np.flatnonzero(energy >= _VISIBLE_ENERGY_SHARE * energy.max())
    )
    return OutsideEffect(
        name, node, size, meter.gain_of_difference(node, added), added, visible_channels, kind.expected_words
    )


def simulate_records(setup: Setup, effect: OutsideEffect) -> dict[str, sensor.Record]:
    """Return the simulated records of both nodes."""
    return {
        node: cases.simulate_node_record(setup, node, [], effect.added if node == effect.node else 0.0)
        for node in SIDES
    }


def _flat_spot(rng, setup, ideal, sample_times):
    """Return a flat spot: an upward impulse when one spot of the tyre touches the road, as speed²."""
    speed, cosine, sine = interpolate(
        ideal, sample_times, ideal.motion.speed, np.cos(ideal.angle), np.sin(ideal.angle)
    )
    position = rng.uniform(-np.pi, np.pi)
    offset = np.arctan2(
        sine * np.cos(position) - cosine * np.sin(position),
        cosine * np.cos(position) + sine * np.sin(position),
    )
    impulse = (speed / 3.0) ** 2 * np.exp(-0.5 * (offset / 0.12) ** 2)
    facing = facing_sign(ideal)
    return stack_channels(ax=impulse * cosine, ay=-facing * impulse * sine)


def _mount_with_play(rng, setup, ideal, sample_times):
    """Return a mount with play: the node tilts across the axle by its play when the torque changes sign."""
    acceleration = differentiate(ideal.motion.speed, ideal.motion.step)
    end_stop, end_stops = 1.0, np.empty(len(acceleration))
    for k, a in enumerate(acceleration.tolist()):
        if a * end_stop < -0.3:
            end_stop = -end_stop
        end_stops[k] = end_stop
    tilt = 1e-3 * sensor.apply_low_pass(end_stops[None], 0.03, ideal.motion.step)[0]
    heading = rng.uniform(-np.pi, np.pi)
    axis = np.array([np.cos(heading), np.sin(heading), 0.0])
    rate = (
        differentiate(tilt, ideal.motion.step) * axis[:, None] - tilt * np.cross(axis, ideal.rate, axisb=0).T
    )
    force = -tilt * np.cross(axis, ideal.force, axisb=0).T
    return sensor.interpolate_cubic(np.vstack([rate, force]), ideal.motion.step, sample_times).T


def _rectified_vibration(rng, setup, ideal, sample_times):
    """Return vibration rectification: a gyro bias proportional to speed²."""
    (speed,) = interpolate(ideal, sample_times, ideal.motion.speed)
    return _along_random_gyro_axis(rng, 1e-3 * speed**2)


def _supply_step(rng, setup, ideal, sample_times):
    """Return a supply step: a permanent step of the gyro bias at a random time."""
    step_time = rng.uniform(0.3, 0.7) * sample_times[-1]
    return _along_random_gyro_axis(rng, 1e-3 * (sample_times > step_time))


def _motor_tone(rng, setup, ideal, sample_times):
    """Return a motor tone: a sine of fixed frequency on one accelerometer axis."""
    tone = 0.05 * np.sin(2.0 * np.pi * rng.uniform(6.0, 40.0) * sample_times + rng.uniform(-np.pi, np.pi))
    return stack_channels(**{str(rng.choice(["ax", "ay", "az"])): tone})


def _temperature_gradient(rng, setup, ideal, sample_times):
    """Return a temperature gradient effect: a gyro bias proportional to the rate of the temperature."""
    (temperature_rate,) = interpolate(
        ideal, sample_times, differentiate(setup.drive.temperature, ideal.motion.step)
    )
    return _along_random_gyro_axis(rng, 0.05 * temperature_rate)


def _magnet(rng, setup, ideal, sample_times):
    """Return a magnet on the frame: a disturbance once per revolution of one gyro axis across the axle.

    The axis along the axle is excluded: there it equals the g-sensitivity, which is in the vocabulary.
    """
    angle = rng.uniform(-np.pi, np.pi)
    (once_per_revolution,) = interpolate(ideal, sample_times, np.cos(ideal.angle - angle))
    return stack_channels(**{str(rng.choice(["gx", "gy"])): 1e-3 * once_per_revolution})


def _bit_errors(rng, setup: Setup, node: str, ideal: IdealReadings, count: int) -> Array:
    """Return bit errors: one bit of the high byte of one axis is inverted in random samples."""
    axis, bit = int(rng.integers(6)), int(rng.integers(8, 12))
    clean = sensor.compute_clean_readings(ideal, {}, setup.sample_times[node], setup.drive.temperature)[
        :, axis
    ]
    hit_indices = rng.permutation(len(clean))[:count]
    is_set = np.round(clean[hit_indices] / LSB[axis]).astype(int) >> bit & 1
    added = np.zeros((len(clean), 6))
    added[hit_indices, axis] = np.where(is_set, -1.0, 1.0) * 2.0**bit * LSB[axis]
    return added


def _no_draw(rng, setup, ideal, sample_times):
    """Raise TypeError, as bit errors have no unit size."""
    raise TypeError("bit errors have a number, not a size")


KINDS: Mapping[str, _Kind] = {
    "tyre_flat_spot": _Kind(_flat_spot, ("revolution", "theta", "wheel angle", "impulse", "pulse")),
    "loose_mount": _Kind(
        _mount_with_play,
        ("torque", "accelerat", "brak", "changes", "hysteresis", "backlash", "loose", "step"),
    ),
    "vibration_rectification": _Kind(_rectified_vibration, ("speed", "spin", "vibration")),
    "supply_step": _Kind(_supply_step, ("step", "jump", "switch", "steps")),
    "bit_error": _Kind(_no_draw, ("bit", "jump", "outlier", "spike", "single samples", "few samples")),
    "motor_tone": _Kind(_motor_tone, ("tone", "hz", "frequency", "periodic", "sine")),
    "temperature_gradient": _Kind(_temperature_gradient, ("temperature", "warm", "heat")),
    "magnet": _Kind(_magnet, ("revolution", "theta", "wheel angle")),
}


def _along_random_gyro_axis(rng, signal: Array) -> Array:
    """Return readings (n, 6) with the signal along a random direction of the three gyro axes."""
    direction = rng.standard_normal(3)
    return np.outer(signal, [*(direction / np.linalg.norm(direction)), 0.0, 0.0, 0.0])
