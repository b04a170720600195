"""Sensor chain of the independent simulator: from ideal rate and specific force to records with time stamps.

`compute_clean_readings` is the deterministic part (mounting, low-pass, scale, bias). `simulate_record` adds
rate random walk, white noise, outliers, saturation, quantization, stale samples and time stamps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from gap_matrix.world import GRAVITY, Array, IdealReadings

GYRO_LSB = float(np.radians(0.070))
ACCEL_LSB = 0.488e-3 * GRAVITY
TEMPERATURE_LSB = 1.0 / 16.0
ZERO_TEMPERATURE = 25.0
EffectParameters = Mapping[
    str, Mapping[str, float]
]  # parameters of one node by effect name, as in the model file


@dataclass(frozen=True)
class Noise:
    """Noise and sampling of a node, independent of hidden effects.

    gyro, accel: 1 sigma per sample as declared in the model file, rad/s and m/s²
    vibration: relative growth of the accelerometer sigma per m/s, not declared
    rate_hz: true sample rate
    jitter: half width of the uniform jitter of sample times, as a fraction of the period
    """

    gyro: float = 0.004
    accel: float = 0.05
    vibration: float = 0.05
    rate_hz: float = 100.0
    jitter: float = 0.08


@dataclass(frozen=True)
class Record:
    """The record of a node.

    t: (n,) time stamps, s
    values: (n, 6) readings, rad/s and m/s²
    temperature: (n,) measured temperature, °C
    """

    t: Array
    values: Array
    temperature: Array


def draw_sample_times(duration: float, noise: Noise, rng: np.random.Generator) -> Array:
    """Return the true sample times, (n,) s, with jitter and at least 20 ms from both ends of the drive."""
    period = 1.0 / noise.rate_hz
    even_times = np.arange(0.02 + rng.uniform(0.0, period), duration - 0.02 - 2.0 * period, period)
    return even_times + period * noise.jitter * rng.uniform(-1.0, 1.0, len(even_times))


def compute_time_stamps(sample_times: Array, effect_parameters: EffectParameters) -> Array:
    """Return the time stamps, (n,) s, of samples at true times, with skew and offset of the clock."""
    skew = effect_parameters.get("clock_skew", {}).get("ppm", 0.0) * 1e-6
    return sample_times * (1.0 + skew) + effect_parameters.get("time_offset", {}).get("delay", 0.0)


def compute_clean_readings(
    channels: IdealReadings, effect_parameters: EffectParameters, sample_times: Array, temperature: Array
) -> Array:
    """Return the readings, (n, 6), at the true sample times, without noise, clipping and rounding."""
    rate, force = channels.rate, channels.force
    if "node_misalignment" in effect_parameters:
        mounting_rotation = Rotation.from_rotvec(
            _axis_vector(effect_parameters["node_misalignment"])
        ).as_matrix()
        rate, force = mounting_rotation.T @ rate, mounting_rotation.T @ force
    if "gyro_lag" in effect_parameters:
        rate = apply_low_pass(rate, effect_parameters["gyro_lag"]["time_constant"], channels.motion.step)
    interpolated = interpolate_cubic(
        np.vstack([rate, force, temperature]), channels.motion.step, sample_times
    )
    true_force, node_temperature = interpolated[3:6], interpolated[6]
    gyro = (
        _scale_axes(interpolated[0:3], effect_parameters, "gyro")
        + _axis_vector(effect_parameters.get("gyro_bias", {}))[:, None]
    )
    force = (
        _scale_axes(true_force, effect_parameters, "accel")
        + _axis_vector(effect_parameters.get("accel_bias", {}))[:, None]
    )
    if "gyro_cubic" in effect_parameters:
        gyro[2] += effect_parameters["gyro_cubic"]["z"] * interpolated[2] ** 3
    if "gyro_warmup" in effect_parameters:
        warmup = effect_parameters["gyro_warmup"]
        gyro += _axis_vector(warmup)[:, None] * -np.expm1(-sample_times / warmup["time_constant"])
    if "gyro_temperature" in effect_parameters:
        gyro += _axis_vector(effect_parameters["gyro_temperature"])[:, None] * (
            node_temperature - ZERO_TEMPERATURE
        )
    if "gyro_g_sensitivity" in effect_parameters:
        gyro[2] += _axis_vector(effect_parameters["gyro_g_sensitivity"]) @ true_force
    return np.vstack([gyro, force]).T


def compute_accel_sigma(noise: Noise, speed: Array) -> Array:
    """Return the true 1 sigma of the accelerometer, (n,) m/s², at a speed."""
    return noise.accel * (1.0 + noise.vibration * np.abs(speed))


def simulate_record(
    channels: IdealReadings,
    effect_parameters: EffectParameters,
    sample_times: Array,
    temperature: Array,
    noise: Noise,
    rng: np.random.Generator,
    added: Array | float = 0.0,
    noise_samples: Array | None = None,
) -> Record:
    """Return the record of a node.

    added: change (n, 6) of the readings before the noise
    noise_samples: (n, 6) noise in place of white noise

    Outliers and stale samples occur in the expected number at random positions, so that a weak effect is
    never absent by chance; each channel has its own outliers.
    """
    values = compute_clean_readings(channels, effect_parameters, sample_times, temperature) + added
    step = channels.motion.step
    speed, node_temperature = interpolate_cubic(
        np.vstack([channels.motion.speed, temperature]), step, sample_times
    )
    count = len(sample_times)
    white_noise = rng.standard_normal((count, 6))
    random_walk = np.cumsum(
        rng.standard_normal((count, 3)) * np.sqrt(np.diff(sample_times, prepend=0.0))[:, None], axis=0
    )
    values[:, :3] += effect_parameters.get("gyro_rate_random_walk", {}).get("k", 0.0) * random_walk
    if noise_samples is None:
        noise_samples = white_noise * noise.gyro
        noise_samples[:, 3:] = compute_accel_sigma(noise, speed)[:, None] * white_noise[:, 3:]
    values += noise_samples
    if "outliers" in effect_parameters:
        outlier_indices = rng.permutation(values.size)[
            : count_hits(effect_parameters["outliers"]["probability"], values.size)
        ]
        outlier_sizes = effect_parameters["outliers"]["sigma"] * rng.standard_normal(len(outlier_indices))
        values.flat[outlier_indices] += outlier_sizes * np.where(
            outlier_indices % 6 < 3, noise.gyro, noise.accel
        )
    for name, axes in (("gyro_saturation", slice(0, 3)), ("accel_saturation", slice(3, 6))):
        limit = effect_parameters.get(name, {}).get("limit", np.inf)
        values[:, axes] = np.clip(values[:, axes], -limit, limit)
    gyro_step = effect_parameters.get("gyro_quantization", {}).get("step", GYRO_LSB)
    values = np.round(values / np.repeat([gyro_step, ACCEL_LSB], 3)) * np.repeat([gyro_step, ACCEL_LSB], 3)
    if "sample_repeat" in effect_parameters:
        stale_indices = (
            1
            + rng.permutation(count - 1)[
                : count_hits(effect_parameters["sample_repeat"]["probability"], count)
            ]
        )
        source_indices = np.arange(count)
        source_indices[stale_indices] = 0
        values = values[np.maximum.accumulate(source_indices)]
    temperature_reading = (
        np.round((node_temperature + 0.02 * rng.standard_normal(count)) / TEMPERATURE_LSB) * TEMPERATURE_LSB
    )
    return Record(compute_time_stamps(sample_times, effect_parameters), values, temperature_reading)


def count_hits(probability: float, count: int) -> int:
    """Return the expected number of hits among `count` samples, rounded, at least one."""
    return max(1, round(probability * count))


def apply_low_pass(value: Array, time_constant: float, step: float) -> Array:
    """Return a low-pass along the last axis, exact for piecewise linear input, initially settled."""
    x = step / time_constant
    decay = np.exp(-x)
    weight_of_new = 1.0 - (1.0 - decay) / x
    weight_of_old = (1.0 - decay) / x - decay
    state = (value[..., :1] * (weight_of_old + decay))[..., :1]
    return lfilter([weight_of_new, weight_of_old], [1.0, -decay], value, axis=-1, zi=state)[0]


def interpolate_cubic(rows: Array, step: float, times: Array) -> Array:
    """Return rows, (k, N) on an even grid, at other times by cubic interpolation of four neighbours."""
    position = times / step
    first_index = np.clip(position.astype(int) - 1, 0, rows.shape[1] - 4)
    u = position - first_index
    weights = (
        (u - 1.0) * (u - 2.0) * (u - 3.0) / -6.0,
        u * (u - 2.0) * (u - 3.0) / 2.0,
        u * (u - 1.0) * (u - 3.0) / -2.0,
        u * (u - 1.0) * (u - 2.0) / 6.0,
    )
    return sum(weight * rows[:, first_index + k] for k, weight in enumerate(weights))


def _scale_axes(value, effect_parameters, sensor):
    """Return rates or forces (3, n) with scale factor and cross-axis errors of `gyro` or `accel`."""
    scaled = value * (1.0 + _axis_vector(effect_parameters.get(f"{sensor}_scale_factor", {}))[:, None])
    if f"{sensor}_nonorthogonality" in effect_parameters:
        cross_axis = effect_parameters[f"{sensor}_nonorthogonality"]
        matrix = [
            [0.0, cross_axis["xz"], -cross_axis["xy"]],
            [-cross_axis["yz"], 0.0, cross_axis["yx"]],
            [cross_axis["zy"], -cross_axis["zx"], 0.0],
        ]
        scaled = scaled + np.array(matrix) @ value
    return scaled


def _axis_vector(parameters):
    """Return the parameters x, y and z as a vector, zeros if absent."""
    return np.array([parameters.get(axis, 0.0) for axis in "xyz"])
