"""What chance brings to the best of many candidates: as often as said, also where scores are uneven."""

import numpy as np
import pytest
from scipy.stats import chi2

from gap_matrix import cases
from gap_matrix.make_case import make
from gap_runs import gap
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.screen.null_distribution import ScoreTest, compute_surprise, draw_null_distribution
from hubodo.gap.screen.screening import screen_candidates
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

SEED = 7
BLOCKS, DIRECTIONS, RUNS = 60, 12, 300


def drawn(rng, common):
    """Scores of blocks and tests of pairs of directions; `common`: of the variance of a whole block."""
    scores = rng.standard_normal((BLOCKS, DIRECTIONS))
    scores *= np.sqrt(1.0 - common + common * BLOCKS * rng.dirichlet(np.full(BLOCKS, 0.2)))[:, None]
    covariance = np.eye(2) / BLOCKS
    bases = [np.eye(DIRECTIONS)[:, k : k + 2] for k in range(0, DIRECTIONS, 2)]
    return scores, [ScoreTest(basis, covariance) for basis in bases]


def best(scores, tests):
    sums = scores.sum(axis=0)
    return max(0.5 * sums @ it.basis @ it.covariance @ it.basis.T @ sums for it in tests)


@pytest.mark.parametrize("common", [0.0, 0.7])
def test_p_values_of_noise_are_below_a_tenth_in_a_tenth_of_all_runs(common):
    """Also where a few blocks have most of the variance: one in which a chi square would be far too sure."""
    rng = np.random.default_rng(SEED)
    below = 0
    for _ in range(RUNS):
        scores, tests = drawn(rng, common)
        below += draw_null_distribution(scores, tests).p_value(best(scores, tests), 2) < 0.1
    assert 0.04 * RUNS < below < 0.17 * RUNS  # 3.5 sigma of the binomial about 0.1


def test_beyond_all_draws_chance_falls_off_as_the_best_of_many_independent_chances():
    """The best of six chi squares of two degrees of freedom is beyond 2 g with about 6 exp(-g)."""
    rng = np.random.default_rng(SEED)
    made = draw_null_distribution(*drawn(rng, 0.0), draws=4000)
    for gain in (8.0, 14.0, 20.0):
        assert abs(np.log(made.p_value(gain, 2)) - np.log(6.0 * np.exp(-gain))) < 0.12 * gain


@pytest.mark.parametrize("freedom", [1, 2, 6])
def test_a_surprise_grows_with_the_gain_also_where_its_chance_is_too_small_for_a_number(freedom):
    """Beside scipy's chi square, as far as that goes."""
    gains = np.array([0.0, 1.0, 250.0, 299.9, 300.1, 350.0, 1e7])
    made = compute_surprise(gains, freedom)
    assert (np.diff(made) > 0.0).all()
    assert made[4] - made[3] == pytest.approx(0.2, abs=0.02)
    assert made[5] == pytest.approx(-chi2.logsf(700.0, freedom), abs=0.01)


def test_without_any_candidate_noise_is_taken_for_independent():
    made = draw_null_distribution(np.zeros((BLOCKS, DIRECTIONS)), [])
    assert made.p_value(10.0, 2) == pytest.approx(np.exp(-10.0))


def test_logs_with_nothing_hidden_have_p_values_that_are_not_small(tmp_path):
    """The best of all effects in each of ten drives: one in ten of a fair test is below 0.1."""
    smallest = []
    for seed in range(40, 50):
        make(tmp_path / str(seed), seed, [], duration=33.0, rate_hz=50.0)
        problem = build_problem(
            read_folder(tmp_path / str(seed)), read_model(tmp_path / str(seed) / "model.toml")
        )
        state, _ = track_wheel_phase(build_initial_state(problem))
        made = screen_candidates(Evaluation(state, estimate_weights(state)))
        freedom = [np.count_nonzero(np.diag(it.information)) for it in made.candidates]
        smallest.append(
            min(
                made.null_distribution.p_value(it.gain, k)
                for it, k in zip(made.candidates, freedom, strict=True)
            )
        )
    assert sorted(smallest)[3] > 0.05
    assert max(smallest) > 0.3


def test_a_coarse_reference_that_cuts_corners_is_not_taken_for_an_effect(tmp_path, monkeypatch):
    """At 10 Hz a straight line between samples is not how this drive went into its turns.

    That leaves a few seconds of large residuals, which some effect always fits best.
    """
    monkeypatch.setattr(cases, "REFERENCE_STEP", 0.1)
    make(tmp_path / "log", SEED, [], duration=60.0, rate_hz=50.0, speed_noise=0.01)
    case = tmp_path / "log"
    made = gap(tmp_path / "out", case / "model.toml", case, "--explain", "gyro_bias")
    assert made.result["found"] == []
    assert "gyro_bias (all) was added in round 1 and removed later" in made.out


def test_with_a_coarse_and_noisy_reference_a_radius_is_still_a_radius(tmp_path, monkeypatch):
    """The noise of the speed turns the wheel within the half second of a window, too.

    Without that, a scale factor of the gyro seems to fit better.
    """
    monkeypatch.setattr(cases, "REFERENCE_STEP", 0.1)
    make(tmp_path / "log", 11, ["wheel_radius"], factor=3.0, duration=33.0, rate_hz=50.0, speed_noise=0.01)
    made = gap(tmp_path / "out", tmp_path / "log" / "model.toml", tmp_path / "log")
    assert [it["effect"] for it in made.result["found"]] == ["wheel_radius"]
