"""A gyro that fails during a drive is left out from there on; one that is valid, or never was, is not."""

import numpy as np
import pytest

from hubodo.fuse.wheel.gyro_failure import find_gyro_failure
from hubodo.fuse.wheel.node_screening import screen_samples
from hubodo.recording import Table

RATE_HZ, SPIN, FAILURE_T = 100.0, 8.0, 60.0
"""Hz; rad/s of a wheel at 1.2 m/s; s."""


def rolling_node(seed=1, seconds=150.0, lever=0.05, bump=2.0):
    """Return a node on a wheel with varying speed, off the axle, with bumps (rms, m/s²)."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    rate = SPIN + 2.0 * np.sin(0.3 * t)
    angle = np.cumsum(rate) / RATE_HZ
    noise = bump * rng.standard_normal((2, len(t)))
    force = -lever * rate**2, 0.0
    return {
        "t": t,
        "gx": 0.01 * rng.standard_normal(len(t)),
        "gy": 0.01 * rng.standard_normal(len(t)),
        "gz": rate + 0.01 * rng.standard_normal(len(t)),
        "ax": 9.81 * np.sin(angle) + force[0] + noise[0],
        "ay": 9.81 * np.cos(angle) + force[1] + noise[1],
        "az": 0.1 * rng.standard_normal(len(t)),
    }


def failed_span(columns):
    """Return the first and last time of the samples that are left out, s."""
    t = columns["t"][find_gyro_failure(Table(columns))]
    return (t[0], t[-1]) if len(t) else None


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(("lever", "bump"), [(0.0, 0.5), (0.05, 2.0), (0.15, 4.0)])
def test_a_valid_gyro_is_used_to_the_end(seed, lever, bump):
    assert failed_span(rolling_node(seed, lever=lever, bump=bump)) is None


@pytest.mark.parametrize("factor", [0.0, 0.5, 2.0, -1.0])
def test_a_gyro_with_another_scale_is_left_out_from_there_on(factor):
    """The sign alone is not seen: a wheel that turns the other way looks alike."""
    columns = rolling_node()
    columns["gz"][columns["t"] >= FAILURE_T] *= factor
    span = failed_span(columns)
    assert span is None if factor == -1.0 else span == (FAILURE_T, columns["t"][-1])


def test_a_gyro_that_recovers_for_half_a_minute_is_used_again():
    columns = rolling_node()
    columns["gz"][(columns["t"] >= FAILURE_T) & (columns["t"] < FAILURE_T + 30.0)] = 3.0
    assert failed_span(columns) == pytest.approx((FAILURE_T, FAILURE_T + 30.0), abs=0.011)
    columns["gz"][columns["t"] > FAILURE_T + 45.0] = 3.0
    assert failed_span(columns) == (FAILURE_T, columns["t"][-1])


def test_a_gyro_that_was_never_valid_is_left_to_other_checks():
    columns = rolling_node()
    columns["gz"] *= 0.5
    assert failed_span(columns) is None


def test_screening_says_from_when_the_gyro_failed():
    columns = rolling_node()
    columns["gz"][columns["t"] >= FAILURE_T] *= 0.5
    screened, (line,) = screen_samples({"left": Table(columns), "right": Table(rolling_node(2))})
    assert len(screened["left"]) == FAILURE_T * RATE_HZ and len(screened["right"]) == 150.0 * RATE_HZ
    assert line.startswith("left: from t = 60.0 to 150.0 s gravity rotates otherwise than gz")
