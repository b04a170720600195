"""Terms of the temperature in an IMU calibration: found, refused, written, and applied to another record."""

import numpy as np
import pytest

import hubodo
from generators.poses import GRAVITY, Errors
from generators.warm_poses import PROFILES, Warmth, carry_warm, draw_warmth, polynomial
from hubodo.calibration.apply import SampleCorrection
from hubodo.calibration.file import CalibratedEffect, NodeCalibration
from hubodo.errors import CalibrationError
from hubodo.sensors.imu.calibrate import calibrate_imu
from hubodo.sensors.imu.gyro_temperature import fit_gyro_polynomial
from hubodo.sensors.imu.page import imu_sections
from hubodo.sensors.imu.pose_temperature import PoseTemperature

GYRO, ACCEL = (
    Errors(b=(0.01, -0.02, 0.005), e=(0.01, -0.01, 0.0)),
    Errors(b=(0.2, -0.1, 0.3), e=(0.0, 0.01, 0.02)),
)

POSE_PERIOD = 8.5
"""s, of a standstill and a turn."""


def record(profile, warmth, seed=5, **options):
    return carry_warm(np.random.default_rng(seed), GYRO, ACCEL, warmth, profile, poses=30, dt=0.02, **options)


@pytest.fixture(scope="module")
def warmth():
    return draw_warmth(np.random.default_rng(2), 2)


@pytest.fixture(scope="module")
def calibrated(warmth):
    t, gyro, accel, temperature = record("up and down", warmth)
    return calibrate_imu(t, gyro, accel, gravity=GRAVITY, temperature=temperature)


def test_biases_and_scales_follow_the_temperature_within_their_sigma(calibrated, warmth):
    effects = calibrated.effect_parameters()
    truths = {"gyro_temperature": warmth.gyro, "accel_temperature": warmth.accel}
    for name, truth in truths.items():
        for n, suffix in enumerate(("", "_quadratic")):
            for k, axis in enumerate("xyz"):
                q = effects[name][axis + suffix]
                assert abs(q.value - truth[n][k]) < 4.0 * q.sigma, (name, axis, suffix)
        assert "x_cubic" not in effects[name]
    scale = effects["accel_scale_temperature"]
    assert all(
        abs(scale[axis].value - warmth.accel_scale[k]) < 4.0 * scale[axis].sigma
        for k, axis in enumerate("xyz")
    )


def test_a_record_at_other_temperatures_is_corrected_by_the_calibration(calibrated, warmth):
    """The file corrects another record, whose temperature the calibration saw, to its noise."""
    t, gyro, accel, temperature = record("two cycles, 30 to 50 °C", warmth, seed=6)
    node = NodeCalibration(
        {name: CalibratedEffect(values) for name, values in calibrated.effect_parameters().items()}
    )
    back = SampleCorrection.from_calibration(node).apply(gyro, accel, temperature=temperature)
    in_pose = (t % POSE_PERIOD > 0.5) & (t % POSE_PERIOD < 5.5) & (temperature < 40.0)
    for raw, corrected, true, limit in (
        (gyro, back[0], 0.0, 1e-3),
        (np.linalg.norm(accel, axis=1), np.linalg.norm(back[1], axis=1), GRAVITY, 8e-3),
    ):
        blocks = np.array_split(np.flatnonzero(in_pose), 10)
        errors = [
            [np.abs(np.mean(values[b], axis=0) - true).max() for b in blocks] for values in (raw, corrected)
        ]
        assert max(errors[1]) < limit and max(errors[1]) < 0.1 * max(errors[0])


def test_a_constant_temperature_gives_no_terms_and_refuses_an_order(warmth):
    t, gyro, accel, temperature = record("constant", warmth)
    result = calibrate_imu(t, gyro, accel, gravity=GRAVITY, temperature=temperature)
    assert not {name for name in result.effect_parameters() if "temperature" in name}
    with pytest.raises(CalibrationError, match=r"span 0\.6 °C, 3 °C are needed"):
        calibrate_imu(t, gyro, accel, gravity=GRAVITY, temperature=temperature, temperature_order=1)
    with pytest.raises(CalibrationError, match="has no temperature"):
        calibrate_imu(t, gyro, accel, gravity=GRAVITY, temperature_order=1)


def test_a_sensor_that_ignores_the_temperature_gets_no_terms():
    none = Warmth(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(3), np.zeros(3))
    t, gyro, accel, temperature = record("up and down", none)
    result = calibrate_imu(t, gyro, accel, gravity=GRAVITY, temperature=temperature)
    assert not {name for name in result.effect_parameters() if "temperature" in name}
    assert any("no term of it is significant" in note for note in result.notes)


def pose_temperatures(profile, count):
    share = (np.arange(count) + 0.5) / count
    poses = PROFILES[profile](share)
    return PoseTemperature(poses, poses, np.gradient(poses), is_one_way=False)


def test_hysteresis_is_named_and_widens_the_bias():
    temperatures = pose_temperatures("up and down", 40)
    rng = np.random.default_rng(3)
    rate = polynomial(np.full((1, 3), 1e-4), temperatures.poses - 25.0) + 1e-5 * rng.standard_normal((40, 3))
    plain = fit_gyro_polynomial(rate, np.full((40, 3), 1e-5), temperatures)
    rate = rate + 2e-4 * np.sign(temperatures.rates)[:, None]
    loop = fit_gyro_polynomial(rate, np.full((40, 3), 1e-5), temperatures, order=1)
    assert plain.order == 1 and plain.hysteresis is None
    np.testing.assert_allclose(loop.hysteresis, 2e-4, rtol=0.1)
    assert np.sqrt(loop.bias_at_reference(np.zeros(3), np.zeros((3, 3)))[1][0, 0]) > 1.9e-4


def test_the_verb_writes_terms_and_page_shows_rate_against_temperature(tmp_path, warmth):
    t, gyro, accel, temperature = record("up and down", warmth)
    log = hubodo.from_arrays(gyro, accel, t=t, temperature=temperature)
    result = log.calibrate_imu(gravity=GRAVITY, temperature_order=2)
    section = next(it for it in imu_sections(result) if it.title == "Rate against temperature")
    assert section.figures and "order 2" in section.text
    with pytest.raises(CalibrationError, match="has no temperature"):
        hubodo.from_arrays(gyro, accel, t=t).calibrate_imu(gravity=GRAVITY, temperature_order=2)
