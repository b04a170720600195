"""Bias estimation while driving: direction of gravity, wheel rate compared with float, errors over drives."""

import math
from types import SimpleNamespace

import gravity_init
import numpy as np
import pytest
import settings
import wire
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scipy.stats import chi2
from small_int import SmallInt

from generators import spin_drives
from hubodo.sensors.filters.pseudo_measurement import PseudoMeasurementFilter
from papers.filters.gravity_rate import rate_from_gravity
from repetitions import first_and_more

LSB_NDPS, ACCEL_LSB_NG = 70_000_000, 488_000
STEP = math.radians(LSB_NDPS * 1e-9)
ACCEL_STEP = ACCEL_LSB_NG * 1e-9 * spin_drives.GRAVITY
PERIOD_NS = 4_807_692
DT = PERIOD_NS * 1e-9
ARM = (0.012, -0.007)
"""Lever arm in m; the setting of the node is in whole mm."""


def create_init(check=lambda x: x, samples=20_000, **overrides):
    s = {
        **settings.DEFAULTS,
        "rate_hz": 208,
        "wheel_radius_mm": round(spin_drives.RADIUS * 1000),
        "arm_mm": [12, -7],
        "bias_sigma_udps": 300_000,
        "phase_mrad": 20,
        "gyro_scale_sigma_ppm": 0,
        **overrides,
    }
    init = gravity_init.GravityInit(wire.BIAS_KIND_GRAVITY, s, SimpleNamespace(period_ns=check(PERIOD_NS)))
    init.start(check(samples), LSB_NDPS, ACCEL_LSB_NG)
    return init


def drive(seed, seconds=100.0, *, noise=1.07, top=1.0, **overrides):
    """Return raw samples (N, 6) and the bias (3,) in gyro steps."""
    rng = np.random.default_rng([5, seed])
    rate = spin_drives.wheel_rate(rng, seconds, DT, standstill_s=1.0, top=top)
    bias = rng.normal(0.0, 4.0, 3)
    gyro, accel = spin_drives.rolling_node(
        rng, rate, DT, bias=bias * STEP, noise=noise * STEP, arm=ARM, tilt=(0.005, -0.005), **overrides
    )
    raw = np.column_stack([gyro / STEP, accel / ACCEL_STEP])
    return np.clip(np.round(raw), -32768, 32767).astype(np.int64), bias


def run_init(init, table, check=int):
    flat = [check(x) for x in table.reshape(-1).tolist()]
    for start in range(0, len(flat), 48):
        if init.update(flat, start, min(8, (len(flat) - start) // 6)):
            return True
    return False


@hypothesis_settings(max_examples=300)
@given(st.integers(-65535, 65535), st.integers(-65535, 65535))
def test_the_angle_agrees_with_atan2(y, x):
    result = gravity_init.angle(SmallInt(y), SmallInt(x))
    error = result * 2 * math.pi / 65536 - math.atan2(y, x)
    assert abs((error + math.pi) % (2 * math.pi) - math.pi) <= (3e-4 if x or y else math.pi)


def test_the_rate_of_each_segment_agrees_with_the_float_version():
    """The float version fits a slope, the node sums with parabolic weights; both correct arm and radius."""
    table, _ = drive(1, 60.0, vibration=0.05)
    init, n = create_init(), 512
    flat, result = table.reshape(-1).tolist(), []
    sums = init._sums
    for at in range(0, len(flat) - 5, 6):
        if sums.add(flat, at) and init.is_usable(sums):
            result.append([init.rate_q14 / 2**14, *(mean / 2**14 for mean in sums.mean_q14)])
    result = np.array(result)
    expected = rate_from_gravity(
        table[:, :3] * STEP, table[:, 3:] * ACCEL_STEP, DT,
        stretch=n, phase_sigma=0.02, radius=spin_drives.RADIUS, arm=0.012 - 0.007j,
    )  # fmt: skip
    assert len(result) == len(expected.rate) > 15
    difference = result - np.column_stack([expected.rate, expected.gyro]) / STEP
    print(f"rate and means apart by at most {np.abs(difference).max(axis=0)} steps")
    # Weights are integers up to 2^13: an error of 1e-4 of the rate change, which is up to 500 steps.
    assert np.abs(difference[:, 1:]).max() < 0.05
    # The node takes the acceleration over eight samples, the float version from differences: up to 0.1 deg/s.
    assert np.abs(difference[:, 0]).max() < 2.0 and abs(difference[:, 0].mean()) < 0.2
    noise = init.filter._noise
    assert (noise >> 8) * 2.0 ** ((noise & 255) - 128) == pytest.approx(
        expected.share * (75 / 70) ** 2, rel=0.01
    )


@pytest.mark.parametrize("n", [32, 100, 512])
def test_the_rate_of_a_uniformly_turning_wheel_is_exact(n):
    """The weights sum to one, so that constant values are exact; the wheel turns once in four samples."""
    sums = gravity_init.GravitySums(n, 0, 0, 0)
    force = ((2048, 0), (0, 2048), (-2048, 0), (0, -2048))
    full = [sums.add([1000, -7, 12345, *force[-k % 4], 0], 0) for k in range(n)]
    assert full == [False] * (n - 1) + [True]
    assert sums.mean_q14 == [1000 << 14, -7 << 14, 12345 << 14]
    assert (sums.turns_q14, sums.turned) == (1 << 14 + 14, (n - 1) << 14)


def test_while_driving_bias_errors_along_the_axle_agree_with_sigma():
    """Drives of 96 s have starts, stops, vibration and a tilted axle; sigma across the axle is unchanged."""
    z, sigmas = [], []
    for seed in range(8):
        table, bias = drive(seed)
        init = create_init()
        assert run_init(init, table) and init.state == wire.FILTER_STATE_TRACKING and init.used > 20
        sigma = np.array(init.sigma_q12) / 2**12
        z.append((init.bias_q14[2] / 2**14 - bias[2]) / sigma[2])
        sigmas.append(sigma)
    sigmas = np.array(sigmas)
    print(f"seeds [5, 0..7]: sigma {np.median(sigmas[:, 2]):.3f} steps, errors / sigma {np.round(z, 2)}")
    low, high = chi2.ppf([0.001, 0.999], len(z))
    assert np.median(sigmas[:, 2]) < 0.25 and low < np.sum(np.square(z)) < high
    assert sigmas[:, :2].min() > 0.9 * 300 / 70


def test_a_configured_scale_error_is_not_estimated_as_bias():
    table, bias = drive(3)
    table[:, 2] = np.round(bias[2] + (table[:, 2] - bias[2]) * 1.01)
    result = {}
    for ppm in (0, 10_000):
        init = create_init(gyro_scale_ppm=ppm)
        assert run_init(init, table)
        result[ppm] = init.bias_q14[2] / 2**14 - bias[2]
    print(f"one percent of scale: bias off by {result}")
    assert abs(result[10_000]) < 0.6 and result[0] > 10 * abs(result[10_000])


@pytest.mark.parametrize("seeds", first_and_more(range(8), range(8, 16)))
def test_sigma_includes_an_unknown_scale_and_strong_vibration(seeds):
    """First a random scale error of 1 % with its setting, then vibration sixteen times that of phase_mrad."""
    errors_by_cause = {}
    for cause in ("scale", "vibration"):
        z = []
        for seed in seeds:
            table, bias = drive([7, seed], 60.0, vibration=0.8 if cause == "vibration" else 0.2)
            if cause == "scale":
                error = np.random.default_rng([8, seed]).normal(0.0, 0.01)
                table[:, 2] = np.round(bias[2] + (table[:, 2] - bias[2]) * (1.0 + error))
            deviation = {"gyro_scale_sigma_ppm": 10_000} if cause == "scale" else {"phase_mrad": 5}
            init = create_init(samples=12_000, bias_sigma_udps=5_000_000, **deviation)
            assert run_init(init, table) and init.state == wire.FILTER_STATE_TRACKING
            z.append((init.bias_q14[2] / 2**14 - bias[2]) / (init.sigma_q12[2] / 2**12))
        errors_by_cause[cause] = z
        print(f"{cause}, seeds [7, {seeds}]: errors / sigma {np.round(z, 2)}")
    for cause, z in errors_by_cause.items():
        low, high = chi2.ppf([0.001, 0.999], len(z))
        assert low < np.sum(np.square(z)) < high, cause


def test_a_stationary_wheel_is_refused():
    rng = np.random.default_rng(2)
    table = np.round(rng.normal((0, 0, 3, 0, 2049, 0), 1.5, (2000, 6))).astype(np.int64)
    init = create_init(samples=2000)
    assert run_init(init, table) and init.refused == wire.REASON_WHEEL_RESTS
    assert init.state == wire.FILTER_STATE_WAITING


def test_a_gap_in_the_samples_is_not_counted_as_rotation():
    table, bias = drive(4)
    cut = np.delete(table, np.arange(6000, 6037), axis=0)
    init = create_init(samples=19_000)
    flat = cut.reshape(-1).tolist()
    for at in range(len(cut)):
        if at == 6000:
            init.gap()
        if init.update(flat, 6 * at, 1):
            break
    assert abs(init.bias_q14[2] / 2**14 - bias[2]) < 4 * init.sigma_q12[2] / 2**12


@pytest.mark.parametrize("n", [32, 512, 1024])
def test_no_intermediate_needs_more_than_31_bits(n):
    rng = np.random.default_rng(n)
    table = rng.choice([-32768, 32767, 0, 1, -1], (3 * n, 6))
    table[:n] = -32768
    init = create_init(SmallInt, 2000, bias_stretch=n, arm_mm=[1000, -1000], wheel_radius_mm=10_000)
    flat = [SmallInt(x) for x in table.reshape(-1).tolist()]
    init.rate_q14 = SmallInt(0)
    for at in range(0, len(flat), 6):
        init.update(flat, at, 1)


def test_the_filter_of_the_node_agrees_with_the_float_filter_on_the_same_segments():
    table, _ = drive(6)
    init, stretches = create_init(), []
    update = init.filter.update

    def recording_update(mean_q14, rate_q14, rate_variance):
        stretches.append(
            (
                np.array(mean_q14) / 2**14,
                rate_q14 / 2**14,
                (rate_variance >> 8) * 2.0 ** ((rate_variance & 255) - 128),
            )
        )
        update(mean_q14, rate_q14, rate_variance)

    init.filter.update = recording_update
    assert run_init(init, table)
    variance = (75 / 70 * STEP) ** 2 * 1.2 / 512
    float_filter = PseudoMeasurementFilter(variance * np.eye(3), sigma=300 / 70 * STEP)
    for mean, rate, rate_variance in stretches:
        float_filter.update((mean * STEP).tolist(), rate * STEP, math.sqrt(rate_variance) * STEP)
    result, expected = np.array(init.bias_q14) / 2**14, np.array(float_filter.bias) / STEP
    print(f"{len(stretches)} stretches: apart by {result - expected} steps")
    assert result == pytest.approx(expected, abs=0.01)
