"""The limit of what a drive tells: thresholds, curves, and an effect that is named above it and not below."""

import numpy as np
import pytest
from scipy.stats import norm

from gap_matrix import cases, effects
from gap_matrix.dose import Meter
from gap_matrix.limit import chance, curve, gap_limit, table
from gap_matrix.limit.choice import Choice, Option
from gap_matrix.limit.oracle import CANDIDATES, SHARED, SPREAD, oracle
from gap_matrix.limit.trial import tried

# Development seeds; half a minute at the usual rate.
SEEDS, SECONDS, NAME = (12_900, 12_901), 33.0, "wheel_slip"


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
    # Choosing has a price, which is that of nothing where the effect is large.
    assert np.all(power.told <= power.priced + 0.12)
    assert power.told[-1] > 0.95
    expected = 0.5 * power.seen.centre * (3.0 * power.half) ** 2
    print(
        f"seed {seed}: {above['found']}, {above['screened']} nats of {expected:.1f}; below: {below['found']}"
    )
    assert above["named"]
    assert not below["named"]
    assert above["screened"] == pytest.approx(expected, abs=4.0 * np.sqrt(2.0 * expected))


@pytest.mark.parametrize("size", [0.5, 2.0, 6.0])
def test_of_two_names_that_look_alike_the_one_that_is_there_is_chosen_as_often_as_it_fits_better(size):
    """One coordinate each, cosine 0.9: the squares of two correlated normals."""
    cosine = 0.9
    gram = np.array([[1.0, cosine], [cosine, 1.0]])
    one, other = np.eye(2)
    options = [Option(name, "left", of[:, None], np.ones(1)) for name, of in (("a", one), ("b", other))]
    told, rival = Choice(gram, options, np.random.default_rng(4)).told(one, size, "a", "left")
    less, more = size * np.sqrt((1.0 - cosine) / 2.0), size * np.sqrt((1.0 + cosine) / 2.0)
    exact = norm.cdf(less) * norm.cdf(more) + norm.cdf(-less) * norm.cdf(-more)
    print(f"seed 4, size {size}: {np.mean(told):.2f}, exactly {exact:.2f}")
    assert rival == "b"
    assert np.mean(told) == pytest.approx(exact, abs=4.0 * np.sqrt(0.25 / len(told)))


def test_where_two_names_fit_alike_their_usual_sizes_do_not_choose():
    """One is found at a thousandth of its usual size, the other at a fiftieth."""
    gram, size = np.array([[1.0, 0.99], [0.99, 1.0]]) * 1e8, 1e-3
    options = [
        Option(name, "left", one[:, None], np.array([usual]))
        for name, one, usual in (("a", np.eye(2)[0], 1.0), ("b", np.eye(2)[1], 0.05))
    ]
    choice = Choice(gram, options, np.random.default_rng(5))
    shares = [np.mean(choice.told(np.eye(2)[k], size, name, "left")[0]) for k, name in enumerate("ab")]
    print(f"seed 5: {shares}")
    assert abs(shares[0] - shares[1]) < 0.3


def test_the_scope_of_what_is_clipped_is_known_where_every_node_shows_it():
    setup = cases.setup(SEEDS[0], duration=SECONDS)
    hidden = cases.hidden_effect(setup, "accel_saturation", "left")
    rng = np.random.default_rng(6)
    chosen = [
        np.mean(chance.statistic(setup, Meter(setup), effects.scaled(hidden, factor), rng)[1])
        for factor in (0.5, 1.3)
    ]
    print(f"seed 6: {chosen}")
    assert chosen[0] < 0.05
    assert chosen[1] > 0.95


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
        told = norm.cdf(np.log(SPREAD / 2.0) / 0.25)
        powers.append(
            {"factors": SPREAD * half, "one": share, "priced": share, "told": told, "rival": "wheel_camber"}
        )
    rng = np.random.default_rng(3)
    x = rng.uniform(-0.5, 1.2, 400)
    seen = rng.standard_normal(400) < (x - np.log(1.4)) / 0.25
    trials = [
        {"key": "track_width/1", "x": at, "named": bool(hit), "found": [], "screened": 1.0, "expected": 1.0}
        for at, hit in zip(x, seen, strict=True)
    ]
    made = table.limit("track_width", trials, powers, 0.02)
    print(f"seed 3, 400 trials: {made.over_seen}, {made.over_told}")
    assert made.over_seen == pytest.approx((1.4, 1.4), rel=0.1)
    assert made.over_told == pytest.approx((0.7, 0.7), rel=0.1)
    assert made.rival == "wheel_camber"
    assert made.named[0] == pytest.approx(1.4 * 0.02 * np.sqrt(0.1 * 0.2), rel=0.1)
