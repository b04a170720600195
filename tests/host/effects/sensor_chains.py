"""A sensor chain of two samples for the tests of single effects."""

import numpy as np

from hubodo.effects import SensorChain


def two_samples(gyro=(0.0, 0.0, 0.0), accel=(0.0, 0.0, 0.0), celsius=25.0):
    """Return two samples with these readings, which are also the true values, at 0 and 1 s."""
    rate, force = (np.tile(np.array(value, float)[:, None], 2) for value in (gyro, accel))
    t = np.array([0.0, 1.0])
    return SensorChain(t, np.full(2, celsius), rate, 0.0 * rate, force, rate.copy(), force.copy())
