"""Residuals of a north estimate: white with unit variance where the model holds, and not where it fails."""

import numpy as np
import pytest

from generators.north_table import EARTH_RATE_DEG_H, Run, Sensor, maytag
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.north_estimate import NorthEstimate, find_north
from hubodo.sensors.north.residuals import compute_residuals
from hubodo.sensors.north.running_estimate import MIN_ESTIMATE_STOPS, RunningEstimate
from hubodo.sensors.north.stops import TableMotion

LATITUDE, AZIMUTH, DT, STOP = np.radians(45.0), 0.4, 0.1, 20.0
EARTH_RATE = np.radians(EARTH_RATE_DEG_H) / 3600.0
WHITE = Sensor(0.05, 0.0, 0.0)
WHITE_DRIFT = DriftNoise(np.radians(0.05) / 60.0, 0.0, 0.0)


def _run(seed: int, stops: int = 8, *, jump: float = 0.0) -> Run:
    """Return stops at 0 and 180 degrees; jump: rad/s added to the rate in the second half of each stop."""
    rng = np.random.default_rng(seed)
    error = WHITE.error(int(stops * (STOP + 2.0) / DT) + 10, DT, rng)
    run = maytag(error, DT, AZIMUTH, LATITUDE, list(np.resize([0.0, np.pi], stops)), STOP, 2.0, rng=rng)
    run.rate[np.mod(run.t, STOP + 2.0) > 0.5 * STOP] += jump
    return run


def _estimate(run: Run) -> NorthEstimate:
    table = TableMotion(run.table_t, run.table_angle, run.table_moving)
    record = AxisRecord(run.t, run.rate, table)
    return find_north([record], LATITUDE, "maytag", settle=1.0, near=AZIMUTH, drift=WHITE_DRIFT)


def test_whitened_residuals_have_unit_variance_where_the_model_holds() -> None:
    whitened = compute_residuals(_estimate(_run(3, 20))).whitened
    # The standard deviation of n values scatters by 1 / sqrt(2 n); the tolerance is four of that.
    assert np.std(whitened) == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * len(whitened)))
    assert abs(np.mean(whitened)) < 4.0 / np.sqrt(len(whitened))


def test_a_rate_that_jumps_within_each_stop_leaves_residuals_that_are_not_white() -> None:
    """The covariance grows with the misfit, so only the correlation of the residuals reveals it."""

    def lag_one(jump: float) -> float:
        whitened = compute_residuals(_estimate(_run(1, jump=jump))).whitened
        return float(np.mean(whitened[1:] * whitened[:-1]) / np.var(whitened))

    # The lag-1 correlation of 64 white values scatters by 1/8; signs that change every fourth value give 1 -
    # 2/4.
    assert abs(lag_one(0.0)) < 3.0 / 8.0
    assert lag_one(1.5 * EARTH_RATE) == pytest.approx(0.5, abs=1.0 / 8.0)


def test_the_modelled_rate_is_that_of_the_earth_along_the_axis() -> None:
    """Residual and drift include the Earth rate error: earth - model = residual."""
    estimate = _estimate(_run(2))
    residuals = compute_residuals(estimate)
    assert residuals.residual == pytest.approx(residuals.earth - residuals.model)
    expected = EARTH_RATE * np.cos(LATITUDE) * np.cos(estimate.azimuth - residuals.angle)
    assert residuals.model == pytest.approx(expected, rel=1e-4, abs=1e-10)
    assert np.all(np.diff(residuals.t) > 0.0)
    assert set(np.round(np.abs(residuals.angle) / np.pi, 6)) == {0.0, 1.0}


def _stops(run: Run) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Return time, rate and axis angle of each stop, without the turns."""
    starts = np.arange(run.t[0], run.t[-1] - STOP / 2.0, STOP + 2.0)
    spans = [(run.t >= start + 1.0) & (run.t < start + STOP - 1.0) for start in starts]
    return [(run.t[span], run.rate[span], float(np.pi * (k % 2))) for k, span in enumerate(spans)]


def test_a_running_estimate_waits_for_four_stops_and_then_agrees_with_that_of_the_record() -> None:
    run = _run(4)
    running = RunningEstimate(EARTH_RATE * np.cos(LATITUDE), near=AZIMUTH)
    sigmas = []
    for t, rate, angle in _stops(run):
        assert running.add_stop(t, rate, angle) == pytest.approx(rate.mean())
        azimuth = running.azimuth()
        assert (azimuth is None) == (running.stops < MIN_ESTIMATE_STOPS)
        if azimuth is not None:
            sigmas.append(azimuth[1])
    final = running.azimuth()
    assert final is not None
    assert final[0] == pytest.approx(_estimate(run).azimuth, abs=final[1])
    assert abs(final[0] - AZIMUTH) < 4.0 * final[1]
    assert sigmas[-1] < 0.6 * sigmas[0]


def test_earlier_records_give_an_estimate_before_the_first_stop() -> None:
    earlier = _estimate(_run(5)).averages
    running = RunningEstimate(EARTH_RATE * np.cos(LATITUDE), earlier, AZIMUTH)
    before = running.azimuth()
    assert before is not None
    for t, rate, angle in _stops(_run(6)):
        running.add_stop(t, rate, angle)
    after = running.azimuth()
    assert after is not None and after[1] < before[1]
