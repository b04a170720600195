"""The detection limit: thresholds, curves, selection of names, and `gap` above and below the limit."""

import numpy as np
import pytest
from scipy.stats import norm

from gap_matrix import cases, effects
from gap_matrix.dose import GainMeter
from gap_matrix.limit import chance, curve, gap_limit, table
from gap_matrix.limit.choice import NameOption, NameSelection
from gap_matrix.limit.oracle import N_CANDIDATES, SHARED_FALSE_ALARM, SIZE_GRID, compute_powers
from gap_matrix.limit.trial import run_trial
from repetitions import first_and_more

# Development seeds; half a minute at a third of the usual rate.
SEEDS, DURATION, RATE_HZ, NAME = (12_900, 12_901), 33.0, 30.0, "wheel_slip"


def test_thresholds_of_rare_false_alarms_are_accurate_with_few_draws():
    nats, rng = 6.0, np.random.default_rng(1)
    drawn = nats + np.sqrt(2.0 * nats) * rng.standard_normal(chance.N_DRAWS)
    for alarm in (1e-2, 1e-4):
        exact = -nats + np.sqrt(2.0 * nats) * norm.isf(alarm)
        assert chance.detection_threshold(drawn, alarm) == pytest.approx(exact, abs=0.35), alarm


def test_a_detection_curve_is_estimated_without_bias_by_adaptive_trials():
    rng, normalised_errors = np.random.default_rng(2), []
    for _ in range(25):
        x: list[float] = []
        is_detected: list[bool] = []
        for _ in range(3):
            ln_sizes = curve.choose_next_sizes(x, is_detected, 6)
            is_detected += (rng.standard_normal(6) < (np.array(ln_sizes) - 0.6) / 0.25).tolist()
            x += ln_sizes
        result = curve.fit_curve(x, is_detected)
        normalised_errors.append((result.middle - 0.6) / result.ln_size_sigma(0.5))
    print(
        f"seed 2, 25 curves: error over its sigma {np.mean(normalised_errors):.2f} "
        f"± {np.std(normalised_errors):.2f}"
    )
    assert abs(np.mean(normalised_errors)) < 0.5
    assert 0.6 < np.std(normalised_errors) < 1.4


def test_the_false_alarm_is_shared_by_all_names_in_their_scopes():
    assert N_CANDIDATES == 26 * 3 + 2
    assert pytest.approx(0.01) == SHARED_FALSE_ALARM * N_CANDIDATES


@pytest.mark.parametrize("seed", first_and_more(*SEEDS))
def test_an_effect_is_named_above_the_limit_with_the_gain_expected_by_the_oracle(seed):
    setup = cases.resample_nodes(
        cases.draw_setup(seed, duration=DURATION), RATE_HZ, np.random.default_rng(seed)
    )
    power = compute_powers(setup, [NAME])[NAME]
    assert power.detected_alone[0] < 0.2
    assert power.detected[-1] > 0.95
    assert np.all(power.detected_alone >= power.detected)
    hidden = cases.draw_hidden_effect(setup, NAME)
    above = run_trial(setup, effects.scale_effect(hidden, 3.0 * power.half_size))
    below = run_trial(setup, effects.scale_effect(hidden, 0.3 * power.half_size))
    assert power.mean_shift is not None
    # Selection reduces the probability of small effects and leaves that of large ones.
    assert np.all(power.identified <= power.detected + 0.12)
    assert power.identified[-1] > 0.95
    expected = 0.5 * power.mean_shift.noncentrality * (3.0 * power.half_size) ** 2
    print(
        f"seed {seed}: {above['found']}, {above['screened']} nats of {expected:.1f}; below: {below['found']}"
    )
    assert above["named"]
    assert not below["named"]
    assert above["screened"] == pytest.approx(expected, abs=4.0 * np.sqrt(2.0 * expected))


@pytest.mark.parametrize("size", [0.5, 2.0, 6.0])
def test_of_two_correlated_names_the_true_one_is_selected_with_the_analytic_probability(size):
    """Each name has one coordinate; their scores are Gaussian with a correlation of 0.9."""
    cosine = 0.9
    gram = np.array([[1.0, cosine], [cosine, 1.0]])
    first, second = np.eye(2)
    options = [
        NameOption(name, "left", direction[:, None], np.ones(1))
        for name, direction in (("a", first), ("b", second))
    ]
    is_selected, alternative = NameSelection(gram, options, np.random.default_rng(4)).select(
        first, size, "a", "left"
    )
    small, large = size * np.sqrt((1.0 - cosine) / 2.0), size * np.sqrt((1.0 + cosine) / 2.0)
    exact = norm.cdf(small) * norm.cdf(large) + norm.cdf(-small) * norm.cdf(-large)
    print(f"seed 4, size {size}: {np.mean(is_selected):.2f}, exactly {exact:.2f}")
    assert alternative == "b"
    assert np.mean(is_selected) == pytest.approx(exact, abs=4.0 * np.sqrt(0.25 / len(is_selected)))


def test_the_typical_size_does_not_select_between_names_that_fit_equally():
    """The size is a thousandth of the typical size of one name and a fiftieth of that of the other."""
    gram, size = np.array([[1.0, 0.99], [0.99, 1.0]]) * 1e8, 1e-3
    options = [
        NameOption(name, "left", first[:, None], np.array([typical_sigma]))
        for name, first, typical_sigma in (("a", np.eye(2)[0], 1.0), ("b", np.eye(2)[1], 0.05))
    ]
    choice = NameSelection(gram, options, np.random.default_rng(5))
    shares = [np.mean(choice.select(np.eye(2)[k], size, name, "left")[0]) for k, name in enumerate("ab")]
    print(f"seed 5: {shares}")
    assert abs(shares[0] - shares[1]) < 0.3


def test_the_scope_of_a_saturation_is_known_if_every_node_exceeds_the_limit():
    setup = cases.draw_setup(SEEDS[0], duration=DURATION)
    hidden = cases.draw_hidden_effect(setup, "accel_saturation", "left")
    rng = np.random.default_rng(6)
    share_selected = [
        np.mean(chance.draw_statistic(setup, GainMeter(setup), effects.scale_effect(hidden, factor), rng)[1])
        for factor in (0.5, 1.3)
    ]
    print(f"seed 6: {share_selected}")
    assert share_selected[0] < 0.05
    assert share_selected[1] > 0.95


def test_the_smallest_effect_with_hits_is_one_hit():
    setup = cases.draw_setup(SEEDS[0], duration=DURATION)
    hidden = cases.draw_hidden_effect(setup, "sample_repeat", "left")
    result = gap_limit.round_to_hits(setup, hidden, 1e-6)
    assert result * hidden.parameters["probability"] * len(setup.sample_times["left"]) == pytest.approx(1.0)


def test_the_ratio_to_the_oracle_is_that_of_the_curves():
    """`gap` needs 1.4 times the size of the oracle, in two drives of different sensitivity."""
    powers = []
    for half in (0.1, 0.2):
        detected = norm.cdf(np.log(SIZE_GRID) / 0.25)
        is_selected = norm.cdf(np.log(SIZE_GRID / 2.0) / 0.25)
        powers.append(
            {
                "factors": SIZE_GRID * half,
                "one": detected,
                "priced": detected,
                "told": is_selected,
                "rival": "wheel_camber",
            }
        )
    rng = np.random.default_rng(3)
    x = rng.uniform(-0.5, 1.2, 400)
    is_detected = rng.standard_normal(400) < (x - np.log(1.4)) / 0.25
    trials = [
        {
            "key": "track_width/1",
            "x": ln_size,
            "named": bool(is_named),
            "found": [],
            "screened": 1.0,
            "expected": 1.0,
        }
        for ln_size, is_named in zip(x, is_detected, strict=True)
    ]
    result = table.compute_limit("track_width", trials, powers, 0.02)
    print(f"seed 3, 400 trials: {result.named_over_detected}, {result.named_over_identified}")
    assert result.named_over_detected == pytest.approx((1.4, 1.4), rel=0.1)
    assert result.named_over_identified == pytest.approx((0.7, 0.7), rel=0.1)
    assert result.nearest_alternative == "wheel_camber"
    assert result.named[0] == pytest.approx(1.4 * 0.02 * np.sqrt(0.1 * 0.2), rel=0.1)
