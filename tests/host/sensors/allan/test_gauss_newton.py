"""Gauss-Newton minimisation: known minima, with a remainder and with bounds."""

import numpy as np
import pytest

from hubodo.sensors.allan.gauss_newton import minimise

WIDE = np.full(2, 100.0)


def rosenbrock(x):
    return np.stack([10.0 * (x[:, 1] - x[:, 0] ** 2), 1.0 - x[:, 0]], axis=1), np.zeros(len(x))


def test_the_minimum_of_the_rosenbrock_function_is_found():
    x, cost = minimise(rosenbrock, np.array([-1.2, 1.0]), -WIDE, WIDE)
    assert x == pytest.approx([1.0, 1.0], abs=1e-2)
    assert cost == pytest.approx(0.0, abs=1e-4)


def test_the_remainder_shifts_the_minimum():
    """The minimum of (x - 1)² + 4 x is at x = -1 and has the value 0."""
    x, cost = minimise(lambda x: (x - 1.0, 4.0 * x[:, 0]), np.zeros(1), -WIDE[:1], WIDE[:1])
    assert x[0] == pytest.approx(-1.0, abs=1e-2)
    assert cost == pytest.approx(0.0, abs=1e-3)


def test_the_minimum_stays_within_the_bounds():
    x, _ = minimise(lambda x: (x - 3.0, np.zeros(len(x))), np.zeros(1), np.array([-1.0]), np.array([2.0]))
    assert x[0] == 2.0
