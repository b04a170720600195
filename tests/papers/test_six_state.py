"""The six-state filter of Barshan and Durrant-Whyte against filterpy on the paper's matrices."""

import math

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from scipy.linalg import block_diag, expm

from generators import start_gyro as start
from hubodo.sensors.filters.six_state import SixState

DEG = math.pi / 180.0
NOISE, DT, AVERAGED = 0.2 * DEG, 0.05, 2000


def test_the_filter_is_filterpys_on_the_matrices_of_the_paper():
    """F of eq. (9): a chain of four integrators, and eq. (6) for the bias; Q of eq. (11), filterpy's own."""
    c1, c2, constant = start.C1 * DEG, start.C2 * DEG, start.T
    theirs = KalmanFilter(6, 1, dim_u=1)
    keep = constant / (constant + DT)
    theirs.F = block_diag(expm(DT * np.eye(4, k=1)), [[1.0, DT], [0.0, keep]])
    theirs.B = np.array([[0, 0, 0, 0, 0, (1.0 - keep) * (c1 + c2)]]).T
    theirs.H, theirs.R = np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 1.0]]), np.array([[NOISE**2]])
    theirs.Q = block_diag(
        Q_continuous_white_noise(4, DT, math.radians(0.05) ** 2),
        Q_continuous_white_noise(2, DT, NOISE**2),
    )
    theirs.x = np.array([[0, 0, 0, 0, 0, -0.3 * DEG]]).T
    theirs.P = np.diag([0.0, NOISE**2, DEG**2, DEG**2, 0.0, NOISE**2 / AVERAGED])
    rates = np.random.default_rng(7).normal(0.1, 0.2, 200) * DEG
    heading, rate, bias = SixState(c1, c2, constant, NOISE, DT).run(rates, np.array(-0.3 * DEG), AVERAGED)
    for k, z in enumerate(rates):
        theirs.predict(u=np.array([[1.0]]))
        theirs.update(z)
        expected = theirs.x[[0, 1, 5], 0]
        assert (heading[k], rate[k], bias[k]) == pytest.approx(expected, rel=1e-6, abs=1e-12)
