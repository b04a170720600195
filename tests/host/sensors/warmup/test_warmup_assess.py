"""Tests of the selection of a warm-up model by the whiteness of its residual."""

from types import SimpleNamespace

import numpy as np
import pytest

from hubodo.effects.warmup import WARMUP_PARAMETERS
from hubodo.sensors.even_grid import EvenGrid
from hubodo.sensors.warmup import assess as room
from hubodo.sensors.warmup.assess import AssessedFit, assess_fit, describe_next_model, select_next_model

AGE, START = 30.0, 1000.0


def bias(t, temperature):
    return 0.02 * np.exp(-t / 40.0) + (0.0 if temperature is None else 1e-3 * temperature)


def record_of(count, dt, temperature=None, missing=(), seed=1):
    """Return a record of a model and white noise on an even grid, in which the samples `missing` are 0."""
    noise = np.random.default_rng(seed).normal(0.0, 1e-3, count)
    present = np.ones(count, bool)
    present[list(missing)] = False
    values = np.where(present, bias(AGE + dt * np.arange(count), temperature) + noise, 0.0)
    record = EvenGrid(values, present, dt, START, (), 0.0, np.zeros(0), ())
    return record, np.where(present, noise, 0.0)


def fit_of(**fields):
    residual = np.random.default_rng(2).normal(size=200)
    return SimpleNamespace(model=SimpleNamespace(bias=bias), residual=residual, **fields)


@pytest.mark.parametrize(
    "count, dt, length, sequences",
    [
        (30_000, 0.02, 500, 10),  # ten seconds each, as in the paper
        (5_400, 0.02, 500, 10),
        (1_800, 0.02, 500, 3),
        (4_000, 1.0, 200, 10),  # at this rate ten seconds are too few samples
        (45_000, 0.001, 2000, 10),  # at this rate ten seconds are more samples than needed
        (150, 0.02, 150, 1),
        (700, 0.02, 500, 1),
    ],
)
@pytest.mark.parametrize("warm", [False, True])
def test_samples_are_tested_in_ten_segments_by_the_residual_of_the_model(count, dt, length, sequences, warm):
    temperature = 20.0 + 3.0 * np.sin(np.arange(count) / 50.0) if warm else None
    record, noise = record_of(count, dt, temperature, missing=range(40, 60))
    result = assess_fit(fit_of(), record, AGE, temperature)
    assert (result.autocorrelation.length, result.autocorrelation.sequences) == (length, sequences)
    lag = np.array([1, 7, length // 2])
    sums = np.zeros(4)
    for k in range(sequences):
        first = int(k * (count - length) / max(sequences - 1, 1))
        part = noise[first : first + length]
        sums += [part @ part, *(part[:-step] @ part[step:] for step in lag)]
    assert result.autocorrelation.autocorrelation[lag - 1] == pytest.approx(sums[1:] / sums[0], abs=1e-9)


def test_block_means_are_tested_by_the_residual_of_the_fit_and_both_tests_must_pass():
    record, _ = record_of(4_000, 1.0)
    coloured, _ = record_of(4_000, 1.0)
    coloured.values[1:] += 0.8 * np.diff(coloured.values) + 2e-3 * np.sin(np.arange(3_999) / 3.0)
    drifting = fit_of()
    drifting.residual = np.cumsum(drifting.residual)
    observed = [
        (one.autocorrelation.is_white, one.ljung_box.is_white, one.is_white)
        for one in (
            assess_fit(fit_of(), record, AGE, None),
            assess_fit(drifting, record, AGE, None),
            assess_fit(fit_of(), coloured, AGE, None),
        )
    ]
    assert observed == [(True, True, True), (True, False, False), (False, True, False)]


def assessed(kind, bic, statistic=50.0, white=False, determined=True, noise=1.0):
    fit = SimpleNamespace(kind=kind, bic=bic, is_determined=determined, noise=noise)
    return AssessedFit(fit, None, SimpleNamespace(statistic=statistic, is_white=white, p_value=0.5, lags=20))


FIRST = assessed("exponential", 100.0, 100.0)
TWO, WARM, BOTH = "two exponentials", "temperature", "exponential and temperature"


@pytest.fixture
def offer(monkeypatch):
    """Run `next_model` with stand-ins for fits and assessments, and record their arguments."""

    def next_of(*models, span=5.0):
        asked = {}
        by_kind = {model.fit.kind: model for model in models}

        def fit_warmup(times, means, kind, grades):
            assert kind in WARMUP_PARAMETERS
            asked[kind] = [grades]
            return by_kind[kind].fit if kind in by_kind else assessed(kind, 1e9).fit

        def assess_fit(fit, record, age, temperature):
            assert age == AGE
            asked[fit.kind].append(temperature)
            return by_kind[fit.kind]

        monkeypatch.setattr(room, "fit_warmup", fit_warmup)
        monkeypatch.setattr(room, "assess_fit", assess_fit)
        t = START + np.array([0.0, 50.0, 100.0])
        grades = None if span is None else np.array([20.0, 20.0 + span])
        temperature = None if span is None else np.array([20.0, 25.0, 40.0])
        record, _ = record_of(51, 2.0)
        return select_next_model(FIRST, t, t, grades, record, t, temperature, AGE), asked

    return next_of


def test_models_with_the_temperature_are_tried_where_it_changed_by_more_than_a_kelvin(offer):
    assert set(offer(span=1.02)[1]) == {TWO, WARM, BOTH}
    assert set(offer(span=0.98)[1]) == set(offer(span=None)[1]) == {TWO}


def test_a_model_of_the_temperature_gets_it_at_the_times_of_means_and_samples_and_no_other_does(offer):
    _, asked = offer(assessed(TWO, 0.0), assessed(WARM, 0.0), assessed(BOTH, 0.0))
    assert asked[TWO] == [None, None]
    for kind in (WARM, BOTH):
        grades, filled = asked[kind]
        assert list(grades) == [20.0, 25.0]
        # Linear from 20 to 25 in 50 s, then to 40, sampled every 2 s.
        assert list(filled) == pytest.approx([*np.arange(20.0, 25.0, 0.2), *np.arange(25.0, 40.1, 0.6)])


def test_the_most_likely_of_the_white_models_follows(offer):
    worse, better = assessed(TWO, 60.0, white=True), assessed(WARM, 50.0, 90.0, white=True)
    coloured = assessed(BOTH, 10.0, 1.0)
    assert offer(worse, better, coloured)[0] is better


@pytest.mark.parametrize("statistic, follows", [(79.0, True), (81.0, False)])
def test_where_none_is_white_the_least_coloured_follows_if_it_is_by_a_fifth(offer, statistic, follows):
    least = assessed(WARM, 50.0, statistic)
    result, _ = offer(assessed(TWO, 20.0, statistic + 0.5), least, assessed(BOTH, 10.0, 99.0))
    assert result is (least if follows else None)


@pytest.mark.parametrize(
    "bic, determined, follows", [(89.0, True, True), (91.0, True, False), (0, False, False)]
)
def test_a_model_must_be_determined_and_pay_for_its_parameters(offer, bic, determined, follows):
    """A difference of ten in the information criterion, odds of 150 to 1."""
    model = assessed(TWO, bic, white=True, determined=determined)
    assert offer(model, span=None)[0] is (model if follows else None)


def test_the_remark_names_the_next_model_and_whether_its_residual_is_white():
    assert "no other model is significantly better" in describe_next_model(FIRST, None)
    white, coloured = (describe_next_model(FIRST, assessed(TWO, 0.0, 7.25, white)) for white in (True, False))
    for words in (white, coloured):
        assert (
            "Ljung-Box 100 over 20 lags" in words
            and "next model: two exponentials" in words
            and "7.25" in words
        )
    assert "still not white" in coloured and "still not white" not in white
