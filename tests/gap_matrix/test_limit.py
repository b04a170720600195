"""The limit of what a drive tells: thresholds, curves, and an effect that is named above it and not below."""

import numpy as np
import pytest
from scipy.stats import norm

from gap_matrix import cases, effects
from gap_matrix.limit import chance, curve, gap_limit, table
from gap_matrix.limit.oracle import CANDIDATES, SHARED, SPREAD, oracle
from gap_matrix.limit.trial import tried

# Development seeds; half a minute at the usual rate.
SEEDS, SECONDS, NAME = (12_900, 12_901), 40.0, "wheel_slip"


def test_a_rare_false_alarm_needs_no_rare_draws():
    nats, rng = 6.0, np.random.default_rng(1)
    drawn = nats + np.sqrt(2.0 * nats) * rng.standard_normal(chance.DRAWS)
    for alarm in (1e-2, 1e-4):
        exact = -nats + np.sqrt(2.0 * nats) * norm.isf(alarm)
        assert chance.threshold(drawn, alarm) == pytest.approx(exact, abs=0.35), alarm


def test_a_curve_is_found_from_trials_that_it_places_itself():
    rng, off = np.random.default_rng(2), []
    for _ in range(40):
        x: list[float] = []
        seen: list[bool] = []
        for _ in range(3):
            asked = curve.next_look(x, seen, 6)
            seen += (rng.standard_normal(6) < (np.array(asked) - 0.6) / 0.25).tolist()
            x += asked
        made = curve.fitted(x, seen)
        off.append((made.middle - 0.6) / made.spread(0.5))
    print(f"seed 2, 40 curves: error over its sigma {np.mean(off):.2f} ± {np.std(off):.2f}")
    assert abs(np.mean(off)) < 0.5
    assert 0.6 < np.std(off) < 1.4


def test_the_price_is_that_of_all_names_in_their_scopes():
    assert CANDIDATES == 26 * 3 + 2
    assert pytest.approx(0.01) == SHARED * CANDIDATES


@pytest.mark.parametrize("seed", SEEDS)
def test_an_effect_is_named_above_the_limit_and_gains_what_the_oracle_counts_on(seed):
    setup = cases.setup(seed, duration=SECONDS)
    power = oracle(setup, [NAME])[NAME]
    assert power.one[0] < 0.2
    assert power.priced[-1] > 0.95
    assert np.all(power.one >= power.priced)
    hidden = cases.hidden_effect(setup, NAME)
    above = tried(setup, effects.scaled(hidden, 3.0 * power.half))
    below = tried(setup, effects.scaled(hidden, 0.3 * power.half))
    assert power.seen is not None
    assert 0.0 < power.seen.beside < power.seen.centre
    expected = 0.5 * power.seen.centre * (3.0 * power.half) ** 2
    print(
        f"seed {seed}: {above['found']}, {above['screened']} nats of {expected:.1f}; below: {below['found']}"
    )
    assert above["named"]
    assert not below["named"]
    assert above["screened"] == pytest.approx(expected, abs=4.0 * np.sqrt(2.0 * expected))


def test_what_comes_in_hits_comes_in_whole_ones():
    setup = cases.setup(SEEDS[0], duration=SECONDS)
    hidden = cases.hidden_effect(setup, "sample_repeat", "left")
    made = gap_limit.in_whole_hits(setup, hidden, 1e-6)
    assert made * hidden.parameters["probability"] * len(setup.taken["left"]) == pytest.approx(1.0)


def test_the_ratio_is_that_of_the_curves():
    """Two drives, of which one shows half as much; `gap` needs 1.4 times what the oracle does."""
    powers = []
    for half in (0.1, 0.2):
        share = norm.cdf(np.log(SPREAD) / 0.25)
        powers.append({"factors": SPREAD * half, "one": share, "priced": share})
    rng = np.random.default_rng(3)
    x = rng.uniform(-0.5, 1.2, 400)
    seen = rng.standard_normal(400) < (x - np.log(1.4)) / 0.25
    trials = [
        {"key": "track_width/1", "x": at, "named": bool(hit), "found": [], "screened": 1.0, "expected": 1.0}
        for at, hit in zip(x, seen, strict=True)
    ]
    made = table.limit("track_width", trials, powers, 0.02)
    print(f"seed 3, 400 trials: {made.ratios}")
    assert made.ratios == pytest.approx((1.4, 1.4), rel=0.1)
    assert made.named[0] == pytest.approx(1.4 * 0.02 * np.sqrt(0.1 * 0.2), rel=0.1)
