"""The likelihood of north, against an independent implementation with full covariance matrices.

A record's averages are a Gaussian vector about C cos + S sin + bias + ramp; the covariance of its drift is
checked by itself in `test_north_parts.py`.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import brentq

from hubodo.sensors.north import likelihood
from hubodo.sensors.north.averages import Averages
from hubodo.sensors.north.carousel import fit_each_turn
from hubodo.sensors.north.circular import single_measured_direction
from hubodo.sensors.north.drift import DriftNoise, drift_covariance
from hubodo.sensors.north.likelihood import azimuth_cramer_rao_bound, estimate_earth_rate
from hubodo.sensors.north.whitening import BEND_ORDER, RAMP_ORDER

HORIZONTAL = 5e-5
AZIMUTH = 0.7
LENGTH = 4.0
DRIFT = DriftNoise(2e-5, 3e-6, 4e-7, 1e-5)
ANGLES = np.array([0.0, 0.5, 1.0, 1.5]) * np.pi


def record(count, seed, drift=DRIFT, angles=ANGLES, measured=False, error=0.0):
    """Return averages of 4 s every 5 s with a bias and a ramp; the table turned in one direction throughout.

    error: relative scale error of the gyro, by which all measured angles are too small.
    """
    rng = np.random.default_rng(seed)
    start = 5.0 * np.arange(count)
    end = start + LENGTH
    angle = np.resize(angles, count)
    turned = np.cumsum(np.append(0.0, np.mod(np.diff(angle), 2 * np.pi)))
    true = angle + error * turned
    y = HORIZONTAL * np.cos(true - AZIMUTH) + 1e-3 + 2e-7 * start
    y = y + np.linalg.cholesky(drift_covariance(drift, start, end)) @ rng.standard_normal(count)
    return Averages(start, end, y, np.cos(angle), np.sin(angle), turned if measured else 0.0 * turned)


@cache
def two_records(measured=False, error=0.0):
    return record(24, 1, measured=measured, error=error), record(17, 2, measured=measured, error=error)


def information_of(drift, piece):
    """Return the inverse covariance (M, M), insensitive to linear trends, and log determinants."""
    inverse = np.linalg.inv(drift_covariance(drift, piece.start, piece.end))
    line = np.column_stack([np.ones(len(piece.y)), piece.start])
    weighed = inverse @ line
    crossed = line.T @ weighed
    # The unit of the linear trend is that of the code; another one would add the same constant for all
    # drifts.
    logdet = -np.linalg.slogdet(inverse)[1] + np.linalg.slogdet(crossed)[1]
    return inverse - weighed @ np.linalg.solve(crossed, weighed.T), logdet


def stacked(drift, records):
    """Return block diagonal information, angles, y, turned and log determinant of all records."""
    parts = [information_of(drift, piece) for piece in records]
    count = sum(len(piece.y) for piece in records)
    whole, at = np.zeros((count, count)), 0
    for part, _ in parts:
        whole[at : at + len(part), at : at + len(part)] = part
        at += len(part)
    angle = np.concatenate([np.arctan2(piece.sin, piece.cos) for piece in records])
    y, turned = (np.concatenate([getattr(piece, name) for piece in records]) for name in ("y", "turned"))
    return whole, angle, y, turned, sum(logdet for _, logdet in parts)


def least_squares(whole, columns, y, prior=0.0):
    """Return estimate and covariance by weighted least squares; prior: information added to each column."""
    spread = np.linalg.inv(columns.T @ whole @ columns + np.diag(np.broadcast_to(prior, columns.shape[1])))
    return spread @ columns.T @ whole @ y, spread


def log_of(density):
    return np.log(np.maximum(density, 1e-300) / density.max())


def near(matrix, relative):
    """Return a matrix to compare with, each element to a fraction of the largest one."""
    return pytest.approx(matrix, rel=0.0, abs=relative * np.abs(matrix).max())


def agree(posterior, expected, within):
    """Compare log densities where they are within five sigma of the maximum."""
    ours, theirs = log_of(posterior.density), expected - expected.max()
    where = theirs > -12.5
    assert where.sum() > 20
    assert ours[where] == pytest.approx(theirs[where], abs=within)


def test_of_a_known_drift_the_rates_are_those_of_weighed_least_squares():
    records = two_records()
    result = estimate_earth_rate(records, HORIZONTAL, DRIFT)
    whole, angle, y, _, _ = stacked(DRIFT, records)
    rate, spread = least_squares(whole, np.column_stack([np.cos(angle), np.sin(angle)]), y)
    assert result.order == RAMP_ORDER and result.drift == DRIFT
    assert result.rate == pytest.approx(rate, abs=1e-6 * HORIZONTAL)
    assert result.rate_covariance == near(spread, 1e-5)
    assert not result.angle_covariance.any()
    off = HORIZONTAL * np.stack([np.cos(result.azimuth), np.sin(result.azimuth)]) - rate[:, None]
    agree(result, -0.5 * np.einsum("ik,ij,jk->k", off, np.linalg.inv(spread), off), 1e-5)
    assert result.density.sum() == pytest.approx(1.0)
    across = HORIZONTAL * np.array([-np.sin(0.3), np.cos(0.3)])
    bound = 1 / np.sqrt(across @ np.linalg.solve(spread, across))
    assert azimuth_cramer_rao_bound(records, result, 0.3, HORIZONTAL) == pytest.approx(bound, rel=1e-5)


def test_the_bound_grows_with_the_noise_without_end():
    """The bound may exceed a radian, which means that the azimuth is undetermined."""
    records = two_records()
    result = estimate_earth_rate(records, HORIZONTAL, DRIFT)
    louder = replace(result, drift=DriftNoise(*(1e3 * np.array([DRIFT.n, DRIFT.b, DRIFT.k, DRIFT.q]))))
    bound = azimuth_cramer_rao_bound(records, result, AZIMUTH, HORIZONTAL)
    assert azimuth_cramer_rao_bound(records, louder, AZIMUTH, HORIZONTAL) == pytest.approx(1e3 * bound)
    assert 1e3 * bound > np.pi


def test_bias_and_ramp_of_each_record_do_not_matter():
    first, second = two_records()
    shifted = Averages(
        second.start, second.end, second.y - 3e-3 + 4e-7 * second.start, second.cos, second.sin, second.turned
    )
    assert estimate_earth_rate([first, shifted], HORIZONTAL, DRIFT).rate == pytest.approx(
        estimate_earth_rate([first, second], HORIZONTAL, DRIFT).rate, abs=1e-6 * HORIZONTAL
    )


def test_where_the_drift_is_unknown_each_size_counts_by_its_restricted_likelihood():
    """The noise level of each record is integrated out, which gives a power of its sum of squares."""
    records = two_records()
    result = estimate_earth_rate(records, HORIZONTAL)
    count = sum(len(piece.y) for piece in records)
    freedom = count - 4
    logs, rates, spreads, drifts = [], [], [], []
    for f in likelihood.FLICKER_RATIOS:
        for w in likelihood.WALK_RATIOS:
            drift = DriftNoise(1.0, np.sqrt(f / LENGTH), np.sqrt(w) / LENGTH)
            whole, angle, y, _, logdet = stacked(drift, records)
            both = np.column_stack([np.cos(angle), np.sin(angle)])
            rate, spread = least_squares(whole, both, y)
            left = y - both @ rate
            level = left @ whole @ left / (freedom - 2)
            off = y[:, None] - HORIZONTAL * np.cos(angle[:, None] - result.azimuth)
            squares = np.einsum("ik,ij,jk->k", off, whole, off)
            logs.append(-0.5 * freedom * np.log(squares) - 0.5 * logdet)
            rates.append(rate)
            spreads.append(spread * level)
            drifts.append(np.sqrt(level) * np.array([drift.n, drift.b, drift.k, drift.q]))
    share = np.exp(np.array(logs) - np.max(logs))
    agree(result, np.log(share.sum(axis=0)), 1e-4)
    weight = share.sum(axis=1) / share.sum()
    mean = weight @ np.array(rates)
    among = np.einsum("k,ki,kj->ij", weight, rates - mean, rates - mean)
    # One density has weights over the whole circle, the other near the peak: it is a single narrow peak.
    assert result.rate == pytest.approx(mean, abs=1e-3 * HORIZONTAL)
    spread = np.average(spreads, axis=0, weights=weight) + among
    assert result.rate_covariance == near(spread, 0.01)
    likely = result.drift
    best = drifts[share.max(axis=1).argmax()]
    assert [likely.n, likely.b, likely.k, likely.q] == pytest.approx(best, rel=1e-4, abs=0.0)


@pytest.mark.parametrize("sigma", [1e-4, 2e-3])
def test_a_small_error_of_the_gyros_scale_is_one_more_unknown_with_a_prior(sigma):
    records = two_records(measured=True)
    result = estimate_earth_rate(records, HORIZONTAL, DRIFT, scale_sigma=sigma)
    whole, angle, y, turned, _ = stacked(DRIFT, records)
    best = result.azimuth[result.density.argmax()]
    both = np.column_stack([np.cos(angle), np.sin(angle)])
    slope = -HORIZONTAL * np.sin(angle - best) * turned
    rate, spread = least_squares(whole, np.column_stack([both, slope]), y, [0.0, 0.0, sigma**-2])
    assert result.rate == pytest.approx(rate[:2], abs=1e-6 * HORIZONTAL)
    assert result.rate_covariance == near(spread[:2, :2], 1e-4)
    alone = least_squares(whole, both, y)[1]
    assert result.angle_covariance == near(spread[:2, :2] - alone, 1e-3)


@pytest.mark.parametrize("sigma", [2e-4, 2e-3, 4e-3])
def test_of_any_error_of_the_gyros_scale_each_size_counts_by_its_prior(sigma):
    """Brute-force integration over scale errors, without linearisation; angles up to 36 rad."""
    records = two_records(measured=True, error=0.5 * sigma)
    result = estimate_earth_rate(records, HORIZONTAL, DRIFT, scale_sigma=sigma)
    whole, angle, y, turned, _ = stacked(DRIFT, records)
    bulk = np.flatnonzero(log_of(result.density) > -2.0)[::2]
    errors = np.linspace(-4 * sigma, 4 * sigma, 81)[:, None, None]
    off = y[:, None] - HORIZONTAL * np.cos((angle + errors * turned)[..., None] - result.azimuth[bulk])[:, 0]
    rows = -0.5 * (errors[:, 0] / sigma) ** 2 - 0.5 * np.einsum(
        "eik,ij,ejk->ek", off, whole, off, optimize=True
    )
    expected = np.log(np.exp(rows - rows.max()).sum(axis=0))
    ours = log_of(result.density)[bulk]
    assert len(bulk) > 5
    assert ours - ours.max() == pytest.approx(expected - expected.max(), abs=0.03)


def test_an_error_of_scale_is_weighed_against_noise_that_is_unknown_too():
    """The scale error with the smallest sum of squares is used, weighted by the noise level."""
    sigma = 2e-3
    records = two_records(measured=True)
    result = estimate_earth_rate(records, HORIZONTAL, scale_sigma=sigma)
    freedom = sum(len(piece.y) for piece in records) - 4
    rows, azimuth = [], result.azimuth[np.flatnonzero(log_of(result.density) > -4.0)[::10]]
    for f in likelihood.FLICKER_RATIOS:
        for w in likelihood.WALK_RATIOS:
            drift = DriftNoise(1.0, np.sqrt(f / LENGTH), np.sqrt(w) / LENGTH)
            whole, angle, y, turned, logdet = stacked(drift, records)
            both = np.column_stack([np.cos(angle), np.sin(angle)])
            every = np.column_stack([both, turned[:, None] * both])
            level = float(y @ whole @ (y - every @ least_squares(whole, every, y)[0])) / (freedom - 4)
            row = []
            for at in azimuth:
                off, slope = y - HORIZONTAL * np.cos(angle - at), -HORIZONTAL * np.sin(angle - at) * turned
                error, spread = least_squares(whole, slope[:, None], off, level / sigma**2)
                left = off - slope * error
                squares = left @ whole @ left + level * error[0] ** 2 / sigma**2
                known = 0.5 * np.log(spread[0, 0])
                row.append(known - 0.5 * freedom * np.log(squares) - 0.5 * logdet + 0.5 * np.log(level))
            rows.append(row)
    expected = np.log(np.exp(np.array(rows) - np.max(rows)).sum(axis=0))
    ours = np.interp(azimuth, result.azimuth, log_of(result.density))
    assert len(azimuth) > 5
    assert ours - ours.max() == pytest.approx(expected - expected.max(), abs=1e-3)


def test_stops_on_one_line_say_nothing_across_it():
    line = 0.4
    observed = record(24, 3, angles=np.array([line, line + np.pi]))
    result = estimate_earth_rate([observed], HORIZONTAL, DRIFT)
    along, across = np.array([np.cos(line), np.sin(line)]), np.array([-np.sin(line), np.cos(line)])
    assert result.rate @ across == pytest.approx(0.0, abs=1e-9 * HORIZONTAL)
    assert np.sqrt(across @ result.rate_covariance @ across) > 1e3 * HORIZONTAL
    assert single_measured_direction(result) in (pytest.approx(line), pytest.approx(line - np.pi))
    assert single_measured_direction(estimate_earth_rate(two_records(), HORIZONTAL, DRIFT)) is None
    whole, angle, y, _, _ = stacked(DRIFT, [observed])
    (rate,), ((variance,),) = least_squares(whole, np.cos(angle - line)[:, None], y)
    assert result.rate @ along == pytest.approx(rate, abs=1e-6 * HORIZONTAL)
    assert along @ result.rate_covariance @ along == pytest.approx(variance, rel=1e-5, abs=0)


def test_a_significant_curve_is_removed_whatever_its_size():
    first, second = two_records()
    time = first.start + first.end
    time = 2 * (time - time.min()) / np.ptp(time) - 1

    def bent(size):
        y = first.y + size * (3e-3 * time**3 - 1e-3 * time**2)
        return estimate_earth_rate(
            [Averages(first.start, first.end, y, first.cos, first.sin, first.turned), second], HORIZONTAL
        )

    assert bent(0.0).order == RAMP_ORDER
    small, large = bent(1.0), bent(2.0)
    assert small.order == large.order == BEND_ORDER
    assert large.rate == pytest.approx(small.rate, abs=1e-6 * HORIZONTAL)


def gain_of(size, whole, bend, y, angle):
    """Return the gain of log likelihood, at the best azimuth and drift, by a curve in the model."""
    lines, curves, best = bend[:, :2], bend, []
    for basis in (lines, curves):
        rows = []
        for inverse, logdet in whole:
            off = (
                y[:, None]
                + size * bend[:, 3:]
                - HORIZONTAL * np.cos(angle[:, None] - likelihood._COARSE_AZIMUTHS)
            )
            white = np.linalg.cholesky(inverse).T
            left = white @ off
            left = left - white @ basis @ np.linalg.lstsq(white @ basis, left, rcond=None)[0]
            rows.append(0.5 * logdet - 0.5 * len(y) * np.log((left**2).sum(axis=0)))
        best.append(np.max(rows))
    return best[1] - best[0]


def test_a_curve_is_accepted_from_a_log_likelihood_gain_of_six():
    """Unrestricted likelihood, because restricted ones of two polynomials are not comparable."""
    (one,) = [record(24, 5, drift=DriftNoise(2e-5, 0.0, 0.0))]
    time = (one.start + one.end) / 2
    bend = np.polynomial.legendre.legvander(2 * (time - time.mean()) / np.ptp(time), 3)
    drifts = [
        DriftNoise(1.0, np.sqrt(f / LENGTH), np.sqrt(w) / LENGTH)
        for f in (0.0, 0.64)
        for w in likelihood.WALK_RATIOS
    ]
    inverses = [np.linalg.inv(drift_covariance(drift, one.start, one.end)) for drift in drifts]
    whole = [(inverse, np.linalg.slogdet(inverse)[1]) for inverse in inverses]
    angle = np.resize(ANGLES, 24)
    orders = []
    for wanted in (5.8, 6.2):
        size = brentq(lambda size: gain_of(size, whole, bend, one.y, angle) - wanted, 0.0, 2e-4, rtol=1e-4)  # noqa: B023
        orders.append(estimate_earth_rate([replace(one, y=one.y + size * bend[:, 3])], HORIZONTAL).order)
    assert orders == [RAMP_ORDER, BEND_ORDER]


@pytest.mark.parametrize("q", [0.0, 3e-4])
def test_vibration_is_distinguished_from_other_noise_and_rejected_if_absent(q):
    """Adjacent intervals: a nudge adds to one what it takes from the next one."""
    start = LENGTH * np.arange(120.0)
    end, angle, n = start + LENGTH, np.resize(np.repeat(ANGLES, 4), 120), 2e-5
    noise = np.linalg.cholesky(drift_covariance(DriftNoise(n, 0.0, 0.0, q), start, end))
    y = noise @ np.random.default_rng(4).standard_normal(120) + HORIZONTAL * np.cos(angle - AZIMUTH)
    result = estimate_earth_rate(
        [Averages(start, end, y, np.cos(angle), np.sin(angle), 0 * y)], HORIZONTAL
    ).drift
    if q:
        # Of 120 differences; the tested sizes are a factor sqrt(10) apart.
        assert result.q == pytest.approx(q, rel=0.3, abs=0.0)
    else:
        assert result.q == 0.0 and result.n == pytest.approx(n, rel=0.25, abs=0.0)


@pytest.mark.parametrize("beyond", [0.97, 1.03])
def test_noise_that_was_given_is_widened_as_a_whole_from_four_sigmas_of_its_variance(beyond):
    records = two_records()
    whole, angle, y, _, _ = stacked(DRIFT, records)
    both = np.column_stack([np.cos(angle), np.sin(angle)])
    left = y - both @ least_squares(whole, both, y)[0]
    freedom = len(y) - 4
    more = left @ whole @ left / (freedom - 2)
    wanted = beyond * (1 + 4 * np.sqrt(2 / freedom))
    given = np.array([DRIFT.n, DRIFT.b, DRIFT.k, DRIFT.q]) * np.sqrt(more / wanted)
    result = estimate_earth_rate(records, HORIZONTAL, DriftNoise(*given)).drift
    now = np.array([result.n, result.b, result.k, result.q])
    assert now == pytest.approx(given * (np.sqrt(wanted) if beyond > 1 else 1.0), rel=1e-5, abs=0.0)


@pytest.mark.parametrize("rows, reported", [(14, False), (15, True), (16, True)])
def test_each_full_turn_of_a_carousel_gives_its_own_rates_whatever_its_bias_and_slope(rows, reported):
    rates, y, angle, turn = [], [], [], []
    for k, size in enumerate((16, rows)):
        at = 2 * np.pi * np.arange(size) / 16
        rates.append((1e-5 * (k + 1), -2e-5 + 3e-6 * k))
        y.append(
            rates[-1][0] * np.cos(at)
            + rates[-1][1] * np.sin(at)
            + 1e-3 * k
            + 1e-6 * np.arange(size) * (k - 2)
        )
        angle.append(at)
        turn.append(np.full(size, float(k)))
    y, angle, turn = map(np.concatenate, (y, angle, turn))
    start = 4.0 * np.arange(len(y))
    observed = Averages(start, start + 4.0, y, np.cos(angle), np.sin(angle), 0 * y)
    along, across = fit_each_turn(observed, turn)
    wanted = rates if reported else rates[:1]
    assert np.column_stack([along, across]) == pytest.approx(np.array(wanted), rel=1e-6, abs=0.0)
