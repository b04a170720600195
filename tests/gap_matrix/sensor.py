"""Sensor chain of the independent simulator: from ideal rate and force to records with time stamps.

`clean` is the part without chance (mounting, low-pass, scale, bias), at any times; `read` adds the rest: rate
random walk, white noise, outliers, saturation, the chip's steps, stale samples and stamps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from gap_matrix.world import GRAVITY, Array, Channels

GYRO_LSB = float(np.radians(0.070))
ACCEL_LSB = 0.488e-3 * GRAVITY
TEMPERATURE_LSB = 1.0 / 16.0
ZERO_TEMPERATURE = 25.0
Settings = Mapping[str, Mapping[str, float]]  # effects of one node: name to parameters, as in the model file


@dataclass(frozen=True)
class Noise:
    """What surrounds every node, hidden effect or not. gyro, accel: 1 sigma per sample, declared. vibration:
    by how much the accelerometer's sigma grows per m/s, as a fraction; declared nowhere. rate_hz: true sample
    rate. jitter: half width of a sample time's spread, fraction of the period."""

    gyro: float = 0.004
    accel: float = 0.05
    vibration: float = 0.05
    rate_hz: float = 100.0
    jitter: float = 0.08


@dataclass(frozen=True)
class Record:
    """A node's file. t: (n,) stamps, s. values: (n, 6) rad/s and m/s². temperature: (n,) °C as written."""

    t: Array
    values: Array
    temperature: Array


def sample_times(duration: float, noise: Noise, rng: np.random.Generator) -> Array:
    """Return the true sample times, (n,) s, uneven and away from both ends of the drive by 20 ms."""
    period = 1.0 / noise.rate_hz
    even = np.arange(0.02 + rng.uniform(0.0, period), duration - 0.02 - 2.0 * period, period)
    return even + period * noise.jitter * rng.uniform(-1.0, 1.0, len(even))


def stamps(taken: Array, settings: Settings) -> Array:
    """Return the time stamps, (n,) s, of samples taken at `taken`."""
    skew = settings.get("clock_skew", {}).get("ppm", 0.0) * 1e-6
    return taken * (1.0 + skew) + settings.get("time_offset", {}).get("delay", 0.0)


def clean(channels: Channels, settings: Settings, taken: Array, temperature: Array) -> Array:
    """Return the readings, (n, 6), at the true times `taken`, without noise, clipping and rounding."""
    rate, force = channels.rate, channels.force
    if "node_misalignment" in settings:
        turned = Rotation.from_rotvec(_vector(settings["node_misalignment"])).as_matrix()
        rate, force = turned.T @ rate, turned.T @ force
    if "gyro_lag" in settings:
        rate = one_pole(rate, settings["gyro_lag"]["time_constant"], channels.motion.step)
    at = sampled(np.vstack([rate, force, temperature]), channels.motion.step, taken)
    true_force, warmth = at[3:6], at[6]
    gyro = _scaled(at[0:3], settings, "gyro") + _vector(settings.get("gyro_bias", {}))[:, None]
    force = _scaled(true_force, settings, "accel") + _vector(settings.get("accel_bias", {}))[:, None]
    if "gyro_cubic" in settings:
        gyro[2] += settings["gyro_cubic"]["z"] * at[2] ** 3
    if "gyro_warmup" in settings:
        warm = settings["gyro_warmup"]
        gyro += _vector(warm)[:, None] * -np.expm1(-taken / warm["time_constant"])
    if "gyro_temperature" in settings:
        gyro += _vector(settings["gyro_temperature"])[:, None] * (warmth - ZERO_TEMPERATURE)
    if "gyro_g_sensitivity" in settings:
        gyro[2] += _vector(settings["gyro_g_sensitivity"]) @ true_force
    return np.vstack([gyro, force]).T


def accel_sigma(noise: Noise, speed: Array) -> Array:
    """Return the true noise of the accelerometer, (n,) m/s², at a speed."""
    return noise.accel * (1.0 + noise.vibration * np.abs(speed))


def read(
    channels: Channels,
    settings: Settings,
    taken: Array,
    temperature: Array,
    noise: Noise,
    rng: np.random.Generator,
    added: Array | float = 0.0,
) -> Record:
    """Return the record of a node; added: (n, 6), added before the noise.

    Outliers and stale samples come in the number their probability says, at random places, so that a weak
    effect is never absent by luck; each channel has its own outliers.
    """
    values = clean(channels, settings, taken, temperature) + added
    step = channels.motion.step
    speed, warmth = sampled(np.vstack([channels.motion.speed, temperature]), step, taken)
    count = len(taken)
    white = rng.standard_normal((count, 6))
    walk = np.cumsum(rng.standard_normal((count, 3)) * np.sqrt(np.diff(taken, prepend=0.0))[:, None], axis=0)
    values[:, :3] += settings.get("gyro_rate_random_walk", {}).get("k", 0.0) * walk
    values[:, :3] += noise.gyro * white[:, :3]
    values[:, 3:] += accel_sigma(noise, speed)[:, None] * white[:, 3:]
    if "outliers" in settings:
        hit = rng.permutation(values.size)[: chosen(settings["outliers"]["probability"], values.size)]
        jump = settings["outliers"]["sigma"] * rng.standard_normal(len(hit))
        values.flat[hit] += jump * np.where(hit % 6 < 3, noise.gyro, noise.accel)
    for name, part in (("gyro_saturation", slice(0, 3)), ("accel_saturation", slice(3, 6))):
        limit = settings.get(name, {}).get("limit", np.inf)
        values[:, part] = np.clip(values[:, part], -limit, limit)
    gyro_step = settings.get("gyro_quantization", {}).get("step", GYRO_LSB)
    values = np.round(values / np.repeat([gyro_step, ACCEL_LSB], 3)) * np.repeat([gyro_step, ACCEL_LSB], 3)
    if "sample_repeat" in settings:
        stale = 1 + rng.permutation(count - 1)[: chosen(settings["sample_repeat"]["probability"], count)]
        source = np.arange(count)
        source[stale] = 0
        values = values[np.maximum.accumulate(source)]
    written = np.round((warmth + 0.02 * rng.standard_normal(count)) / TEMPERATURE_LSB) * TEMPERATURE_LSB
    return Record(stamps(taken, settings), values, written)


def chosen(probability: float, count: int) -> int:
    """Return the number of hits among `count` samples, at least one."""
    return max(1, round(probability * count))


def one_pole(value: Array, time_constant: float, step: float) -> Array:
    """Return the low-pass along the last axis, exact for piecewise linear input, starting settled."""
    x = step / time_constant
    decay = np.exp(-x)
    new = 1.0 - (1.0 - decay) / x
    old = (1.0 - decay) / x - decay
    state = (value[..., :1] * (old + decay))[..., :1]
    return lfilter([new, old], [1.0, -decay], value, axis=-1, zi=state)[0]


def sampled(rows: Array, step: float, at: Array) -> Array:
    """Return rows, (k, N) on the even grid, at the times `at`, by the cubic through four neighbours."""
    position = at / step
    first = np.clip(position.astype(int) - 1, 0, rows.shape[1] - 4)
    u = position - first
    weights = (
        (u - 1.0) * (u - 2.0) * (u - 3.0) / -6.0,
        u * (u - 2.0) * (u - 3.0) / 2.0,
        u * (u - 1.0) * (u - 3.0) / -2.0,
        u * (u - 1.0) * (u - 2.0) / 6.0,
    )
    return sum(weight * rows[:, first + k] for k, weight in enumerate(weights))


def _scaled(value, settings, sensor):
    made = value * (1.0 + _vector(settings.get(f"{sensor}_scale_factor", {}))[:, None])
    if f"{sensor}_nonorthogonality" in settings:
        d = settings[f"{sensor}_nonorthogonality"]
        cross = [[0.0, d["xz"], -d["xy"]], [-d["yz"], 0.0, d["yx"]], [d["zy"], -d["zx"], 0.0]]
        made = made + np.array(cross) @ value
    return made


def _vector(parameters):
    return np.array([parameters.get(axis, 0.0) for axis in "xyz"])
