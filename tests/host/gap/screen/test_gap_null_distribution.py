"""Null distribution of the best gain over many candidates: calibrated p-values, also for uneven scores."""

import numpy as np
import pytest
from scipy.stats import chi2

from gap_matrix import cases
from gap_matrix.make_case import write_case
from gap_runs import run_gap
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.screen.null_distribution import ScoreTest, compute_surprise, draw_null_distribution
from hubodo.gap.screen.screening import screen_candidates
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

SEED = 7
N_BLOCKS, N_DIRECTIONS, N_RUNS = 60, 12, 300


def draw_scores_and_tests(rng, shared_variance):
    """Return block scores (N_BLOCKS, N_DIRECTIONS) and tests of pairs of directions.

    shared_variance: part of the variance that is distributed unevenly over the blocks
    """
    scores = rng.standard_normal((N_BLOCKS, N_DIRECTIONS))
    scores *= np.sqrt(
        1.0 - shared_variance + shared_variance * N_BLOCKS * rng.dirichlet(np.full(N_BLOCKS, 0.2))
    )[:, None]
    covariance = np.eye(2) / N_BLOCKS
    bases = [np.eye(N_DIRECTIONS)[:, k : k + 2] for k in range(0, N_DIRECTIONS, 2)]
    return scores, [ScoreTest(basis, covariance) for basis in bases]


def best_gain(scores, tests):
    """Return the largest gain of all tests."""
    sums = scores.sum(axis=0)
    return max(0.5 * sums @ it.basis @ it.covariance @ it.basis.T @ sums for it in tests)


@pytest.mark.parametrize("shared_variance", [0.0, 0.7])
def test_p_values_of_noise_are_calibrated_at_one_tenth(shared_variance):
    """If few blocks have most of the variance, a chi-square distribution would be far too optimistic."""
    rng = np.random.default_rng(SEED)
    n_below_tenth = 0
    for _ in range(N_RUNS):
        scores, tests = draw_scores_and_tests(rng, shared_variance)
        n_below_tenth += draw_null_distribution(scores, tests).p_value(best_gain(scores, tests), 2) < 0.1
    assert 0.04 * N_RUNS < n_below_tenth < 0.17 * N_RUNS  # 3.5 sigma of the binomial about 0.1


def test_p_values_beyond_all_draws_follow_the_tail_of_a_maximum_of_chi_squares():
    """The maximum of six chi squares of 2 degrees of freedom exceeds 2 g with probability 6 exp(-g)."""
    rng = np.random.default_rng(SEED)
    null = draw_null_distribution(*draw_scores_and_tests(rng, 0.0), draws=4000)
    for gain in (8.0, 14.0, 20.0):
        assert abs(np.log(null.p_value(gain, 2)) - np.log(6.0 * np.exp(-gain))) < 0.12 * gain


@pytest.mark.parametrize("dof", [1, 2, 6])
def test_surprise_increases_with_gain_beyond_floating_point_underflow(dof):
    """The reference is scipy's chi-square log survival function."""
    gains = np.array([0.0, 1.0, 250.0, 299.9, 300.1, 350.0, 1e7])
    surprise = compute_surprise(gains, dof)
    assert (np.diff(surprise) > 0.0).all()
    assert surprise[4] - surprise[3] == pytest.approx(0.2, abs=0.02)
    assert surprise[5] == pytest.approx(-chi2.logsf(700.0, dof), abs=0.01)


def test_without_candidates_the_null_distribution_is_that_of_independent_noise():
    null = draw_null_distribution(np.zeros((N_BLOCKS, N_DIRECTIONS)), [])
    assert null.p_value(10.0, 2) == pytest.approx(np.exp(-10.0))


def test_p_values_of_clean_logs_are_not_small(tmp_path):
    """p-value of the best effect in each of ten drives; of ten calibrated p-values, one is below 0.1."""
    smallest_p_values = []
    for seed in range(40, 50):
        write_case(tmp_path / str(seed), seed, [], duration=33.0, rate_hz=30.0)
        problem = build_problem(
            read_folder(tmp_path / str(seed)), read_model(tmp_path / str(seed) / "model.toml")
        )
        state, _ = track_wheel_phase(build_initial_state(problem))
        screening = screen_candidates(Evaluation(state, estimate_weights(state)))
        dof = [np.count_nonzero(np.diag(it.information)) for it in screening.candidates]
        p_values = [
            screening.null_distribution.p_value(it.gain, k)
            for it, k in zip(screening.candidates, dof, strict=True)
        ]
        smallest_p_values.append(min(p_values))
    assert sorted(smallest_p_values)[3] > 0.05
    assert max(smallest_p_values) > 0.3


def test_interpolation_error_of_a_coarse_reference_is_not_reported_as_an_effect(tmp_path, monkeypatch):
    """Linear interpolation at 10 Hz is wrong at the beginning of turns.

    That leaves some seconds of large residuals, to which some effect always fits best.
    """
    monkeypatch.setattr(cases, "REFERENCE_STEP", 0.1)
    write_case(tmp_path / "log", SEED, [], duration=60.0, rate_hz=50.0, speed_noise=0.01)
    case = tmp_path / "log"
    assert run_gap(tmp_path / "out", case / "model.toml", case).result["found"] == []


def test_a_wheel_radius_error_is_found_with_a_coarse_and_noisy_reference(tmp_path, monkeypatch):
    """Speed noise also changes the wheel phase within a window of 0.5 s.

    If that is neglected, a gyro scale factor fits better.
    """
    monkeypatch.setattr(cases, "REFERENCE_STEP", 0.1)
    write_case(
        tmp_path / "log", 11, ["wheel_radius"], factor=3.0, duration=33.0, rate_hz=50.0, speed_noise=0.01
    )
    run = run_gap(tmp_path / "out", tmp_path / "log" / "model.toml", tmp_path / "log")
    assert [it["effect"] for it in run.result["found"]] == ["wheel_radius"]
