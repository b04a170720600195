"""Time stamps, repeated samples and outliers, calculated by hand."""

import numpy as np
import pytest
from sensor_chains import two_samples

from hubodo.effects import Noise
from hubodo.effects.timing import ClockSkew, Outliers, SampleRepeat, TimeOffset


def test_true_times_invert_delay_and_skew():
    stamps = np.array([0.0, 10.0, 100.0])
    np.testing.assert_allclose(TimeOffset(0.2).true_time(stamps), [-0.2, 9.8, 99.8])
    np.testing.assert_allclose(ClockSkew(500.0).true_time(stamps * (1.0 + 5e-4)), stamps)


def test_a_repeated_sample_has_all_values_of_its_predecessor():
    chain = two_samples()
    chain.gyro[:, 1], chain.accel[:, 1] = 1.0, 2.0
    SampleRepeat(1.0).repeat_samples(chain, np.random.default_rng(0))
    assert not chain.gyro.any() and not chain.accel.any()


def test_outliers_add_their_share_of_the_variance():
    assert Outliers(0.01, 10.0).added_variance(Noise(0.1, 1.0)) == (pytest.approx(0.01), pytest.approx(1.0))
    chain = two_samples()
    Outliers(0.0, 10.0).add_outliers(chain, Noise(0.1, 1.0), np.random.default_rng(0))
    assert not chain.gyro.any()
