"""Warm-up of the gyro bias, by hand."""

import numpy as np
import pytest
from sensor_chains import two_samples

from hubodo.effects.warmup import GyroWarmup, WarmupModel, warmup_fraction


def test_a_time_constant_completes_63_percent():
    assert warmup_fraction(np.array([0.0, 5.0]), 5.0) == pytest.approx([0.0, 1.0 - np.exp(-1.0)])


def test_two_exponentials_add_up_in_effect_and_model():
    chain = two_samples()
    GyroWarmup(z=0.1, time_constant=1.0, z_second=0.2, time_constant_second=2.0).add_offsets(chain)
    expected = 0.1 * (1.0 - np.exp(-1.0)) + 0.2 * (1.0 - np.exp(-0.5))
    assert chain.gyro[2] == pytest.approx([0.0, expected])
    model = WarmupModel(0.5, 0.1, 1.0, 0.2, 2.0)
    assert model.bias(chain.t) == pytest.approx([0.5, 0.5 + expected])
    with pytest.raises(ValueError, match="needs the temperature"):
        WarmupModel(0.5, temperature_coefficient=0.1).bias(chain.t)


def test_an_unusual_time_constant_is_penalised():
    """Two-sided tail of a log-normal prior: median 60 s, 1σ a factor of three; 31.7 % at 1σ."""
    assert GyroWarmup(time_constant=60.0).neg_log_prior() == pytest.approx(0.0)
    assert GyroWarmup(time_constant=180.0).neg_log_prior() == pytest.approx(-np.log(0.3173), abs=1e-3)
