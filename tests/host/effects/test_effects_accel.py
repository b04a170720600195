"""Effects of the accelerometer, by hand."""

import numpy as np
from sensor_chains import two_samples

from hubodo.effects.accel import AccelBias, AccelNonorthogonality, AccelSaturation, AccelScaleFactor


def test_bias_scale_and_cross_axis_add_to_the_force():
    chain = two_samples(accel=(1.0, 2.0, 10.0))
    AccelScaleFactor(z=0.01).add_scale_errors(chain)
    AccelNonorthogonality(zy=0.02).add_scale_errors(chain)
    AccelBias(x=0.1).add_offsets(chain)
    np.testing.assert_allclose(chain.accel[:, 1], [1.1, 2.0, 10.0 + 0.1 + 0.02])


def test_readings_are_clipped_on_both_sides():
    chain = two_samples(accel=(-20.0, 3.0, 20.0))
    AccelSaturation(limit=5.0).clip_readings(chain)
    np.testing.assert_array_equal(chain.accel[:, 0], [-5.0, 3.0, 5.0])
