"""Reasons to doubt a finding."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hubodo.effects import BY_NAME, effect_of
from hubodo.gap.explain.doubt import (
    _is_beside_walk,
    _is_contested,
    _is_hardly_repeated,
    _is_imitated,
    _is_shapeless,
    is_doubted,
    widen_sigmas_by_doubtful_effects,
)
from hubodo.gap.explain.result import Estimate
from hubodo.gap.judge.hypothesis import DOUBTFUL_LEVEL, UNHELPFUL, Hypothesis
from hubodo.gap.refit.cross_validation import HeldOutGain
from hubodo.gap.state.terms import ModelTerm


def test_an_effect_is_contested_by_one_that_fits_as_well_and_only_fails_on_held_out_samples():
    held_out = HeldOutGain(100.0, 1.0, 1.0)
    own = Hypothesis(ModelTerm(BY_NAME["time_offset"](), "left"), 281.5, 90.0, 1.0, held_out_gain=held_out)
    skew = Hypothesis(ModelTerm(BY_NAME["clock_skew"](), "all"), 281.6, 90.0, 0.0).with_objection(UNHELPFUL)
    assert _is_contested(own, [own, skew])
    assert not _is_contested(own, [own, replace(skew, gain=250.0)])
    assert not _is_contested(own, [own, replace(skew, objection="not physical")])
    more_coordinates = ModelTerm(BY_NAME["gyro_nonorthogonality"](), "all")
    assert not _is_contested(own, [own, replace(skew, term=more_coordinates)])


def test_a_formula_without_a_name_is_one_of_several_that_fit():
    state = SimpleNamespace(terms=(), problem=SimpleNamespace(nodes=()), has_correlated_noise=False)
    result = SimpleNamespace(
        final=SimpleNamespace(state=state, min_tempering=1.0), rounds=[SimpleNamespace(tempering=1.0)]
    )
    unnamed = ModelTerm(effect_of("empirical:gx ~ spin^2*cos(2*theta)")(), "left")
    assert is_doubted(unnamed, None, [], {}, result, {})
    assert not is_doubted(ModelTerm(BY_NAME["lever_arm"](), "left"), None, [], {}, result, {})


def test_an_effect_at_its_plausible_limit_may_be_another_one():
    state = SimpleNamespace(terms=(), problem=SimpleNamespace(nodes=()), has_correlated_noise=False)
    result = SimpleNamespace(
        final=SimpleNamespace(state=state, min_tempering=1.0), rounds=[SimpleNamespace(tempering=1.0)]
    )
    for xz, expected in ((0.15, True), (0.03, False)):
        term = ModelTerm(BY_NAME["accel_nonorthogonality"](xz=xz), "all")
        assert is_doubted(term, None, [], {}, result, {}) == expected


@pytest.mark.parametrize(
    ("n_blocks", "min_tempering", "gain", "expected"),
    [(6, 3.5, 10000.0, True), (16, 3.5, 700.0, False), (6, 1.0, 700.0, False), (6, 3.5, 12000.0, False)],
)
def test_a_short_log_of_uneven_noise_confirms_no_effect_below_its_level(
    n_blocks, min_tempering, gain, expected
):
    """A g-sensitivity gained 720 nats on held-out samples of 21 s of a wheelchair."""
    term = ModelTerm(BY_NAME["gyro_g_sensitivity"](), "right")
    own = Hypothesis(term, gain, 100.0, 1.0, held_out_gain=HeldOutGain(gain, 21.0, 3551.0))
    final = SimpleNamespace(min_tempering=min_tempering, block_scores=np.zeros((n_blocks, 3)))
    assert _is_hardly_repeated(own, final) == expected


@pytest.mark.parametrize(
    ("agreement_sigmas", "tempering", "held_out", "expected"),
    [
        (1.0, 8.0, True, True),
        (4.0, 8.0, True, False),
        (1.0, 1.5, True, False),
        (0.0, 8.0, False, False),
    ],
)
def test_an_effect_on_which_the_parts_of_a_correlated_log_disagree_may_be_another_one(
    agreement_sigmas, tempering, held_out, expected
):
    gain = HeldOutGain(2000.0, 40.0, 3000.0) if held_out else None
    term = ModelTerm(BY_NAME["gyro_warmup"](), "right")
    own = Hypothesis(term, 2500.0, 130.0, 1.0, held_out_gain=gain, agreement_sigmas=agreement_sigmas)
    state = SimpleNamespace(terms=(), problem=SimpleNamespace(nodes=()), has_correlated_noise=False)
    final = SimpleNamespace(state=state, min_tempering=1.0)
    result = SimpleNamespace(final=final, rounds=[SimpleNamespace(tempering=tempering)])
    assert is_doubted(term, own, [own], {}, result, {}) == expected


def test_a_drift_without_a_known_time_constant_may_be_another_one():
    amplitude = {"x": Estimate(1e-3, 2e-4, "rad/s")}
    assert _is_shapeless({**amplitude, "time_constant": Estimate(28.7, 19.5, "s")})
    assert _is_shapeless({**amplitude, "time_constant": Estimate(2635.0, None, "s")})
    assert not _is_shapeless({**amplitude, "time_constant": Estimate(28.7, 3.0, "s")})
    # The time constant of a lag is its size.
    assert not _is_shapeless({"time_constant": Estimate(2e-3, 1e-3, "s")})
    assert not _is_shapeless(amplitude)


def test_weights_with_the_correlation_of_the_noise_show_that_it_is_correlated():
    gain = HeldOutGain(2000.0, 40.0, 3000.0)
    own = Hypothesis(ModelTerm(BY_NAME["gyro_warmup"](), "right"), 2500.0, 130.0, 1.0, held_out_gain=gain)
    state = SimpleNamespace(terms=(), problem=SimpleNamespace(nodes=()), has_correlated_noise=True)
    final = SimpleNamespace(state=state, min_tempering=1.0)
    result = SimpleNamespace(final=final, rounds=[SimpleNamespace(tempering=1.0)])
    assert is_doubted(own.term, own, [own], {}, result, {})


def test_a_walk_is_in_doubt_if_the_temperature_explains_nearly_as_much():
    walk = Hypothesis(ModelTerm(BY_NAME["gyro_rate_random_walk"](k=5e-4), "left"), 9000.0, 2500.0, 1.0)
    temperature = Hypothesis(
        ModelTerm(BY_NAME["gyro_temperature"](), "left"),
        8560.0,
        2400.0,
        0.0,
        held_out_gain=HeldOutGain(8400.0, 30.0, 800.0),
    )
    assert _is_imitated(walk, [walk, temperature])
    assert not _is_imitated(walk, [walk, replace(temperature, gain=5800.0)])
    assert not _is_imitated(walk, [walk, temperature.with_objection(UNHELPFUL)])
    assert not _is_imitated(temperature, [walk, temperature])


@pytest.mark.parametrize(("scope", "expected"), (("left", True), ("all", True), ("right", False)))
def test_a_warm_up_is_in_doubt_beside_a_random_walk_of_the_same_gyro(scope, expected):
    walk = ModelTerm(BY_NAME["gyro_rate_random_walk"](k=5e-4), scope)
    result = SimpleNamespace(final=SimpleNamespace(state=SimpleNamespace(terms=(walk,))))
    warmup = ModelTerm(BY_NAME["gyro_warmup"](z=0.01), "left")
    parameters = {"z": Estimate(0.01, 1e-4, "rad/s"), "time_constant": Estimate(20.0, 1.0, "s")}
    assert _is_beside_walk(warmup, parameters, result) == expected
    bias = ModelTerm(BY_NAME["gyro_bias"](z=0.01), "left")
    assert not _is_beside_walk(bias, {"z": parameters["z"]}, result)


def test_a_sigma_contains_the_change_by_an_effect_that_only_the_level_of_the_noise_excludes():
    """A scale error of a car, 0.5 %, was given as a bias of 0.06 ± 0.006 rad/s where no model was learnt."""
    bias = ModelTerm(BY_NAME["gyro_bias"](x=0.03, z=-0.06), "left")
    with_scale = ModelTerm(BY_NAME["gyro_bias"](x=0.03, z=-0.006), "left")
    scale = ModelTerm(BY_NAME["gyro_scale_factor"](z=-0.005), "all")
    estimates = {
        "x": Estimate(0.03, 4e-4, "rad/s"),
        "y": Estimate(0.0, None, "rad/s"),
        "z": Estimate(-0.06, 0.006, "rad/s"),
    }
    doubtful = Hypothesis(
        scale,
        2500.0,
        -50.0,
        0.0,
        state=SimpleNamespace(terms=(with_scale, scale)),
        held_out_gain=HeldOutGain(3000.0, 100.0, 8000.0),
        objection=DOUBTFUL_LEVEL,
        surprise=86.0,
    )
    widened = widen_sigmas_by_doubtful_effects(bias, estimates, [doubtful])
    assert widened["z"].sigma == pytest.approx(np.hypot(0.054, 0.006))
    assert (widened["x"], widened["y"]) == (estimates["x"], estimates["y"])
    for other in (
        replace(doubtful, objection=UNHELPFUL),
        replace(doubtful, surprise=5.0),
        replace(doubtful, held_out_gain=HeldOutGain(300.0, 100.0, 8000.0)),
        replace(doubtful, held_out_gain=None),
    ):
        assert widen_sigmas_by_doubtful_effects(bias, estimates, [other]) == estimates
