"""Effects of the gyro, by hand."""

import numpy as np
import pytest
from sensor_chains import two_samples

from hubodo.effects.gyro import GyroCubic, GyroGSensitivity, GyroQuantization, GyroSaturation
from hubodo.effects.temperature import GyroTemperature


def test_a_cubic_error_is_removed_exactly():
    chain = two_samples(gyro=(0.0, 0.0, 10.0))
    effect = GyroCubic(z=1e-4)
    effect.add_scale_errors(chain)
    assert chain.gyro[2, 0] == pytest.approx(10.1)
    np.testing.assert_allclose(effect.remove_nonlinearity(chain.gyro, np.eye(3)), chain.rate, atol=1e-12)
    assert not effect.why_irreversible()
    assert GyroCubic(z=-1e-3).why_irreversible()


def test_temperature_and_force_shift_the_bias():
    chain = two_samples(accel=(0.0, 2.0, 0.0), celsius=35.0)
    GyroTemperature(z=1e-3).add_offsets(chain)
    GyroGSensitivity(y=1e-2, xy=3e-2).add_offsets(chain)
    np.testing.assert_allclose(chain.gyro[:, 0], [0.06, 0.0, 0.01 + 0.02])


def test_readings_are_clipped_then_rounded():
    chain = two_samples(gyro=(0.26, -3.0, 0.0))
    GyroSaturation(limit=1.0).clip_readings(chain)
    GyroQuantization(step=0.1).quantize_readings(chain)
    np.testing.assert_allclose(chain.gyro[:, 0], [0.3, -1.0, 0.0])
