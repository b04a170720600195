"""The warm-up on the node: eq. 6 in integers beside the exponential, and what the settings make of it."""

import math
import time
from types import SimpleNamespace

import bias_choice
import numpy as np
import pytest
import settings
import warm_up
from small_int import SmallInt

from fakes.fake_port import PORT_TICKS, TICKS
from hubodo.effects.warmup import WarmupModel
from papers.filters.warmup_recursion import BiasRecursion

CHIP = SimpleNamespace(gyro_lsb_ndps=70_000_000)


def course(c1, time_constant, *, seconds, age_ms=0, start_ms=0):
    """(N,) s and (N,) steps: grown by the node, looked at every 20 ms."""
    warm = warm_up.WarmUp([round(c1 * 2**18), 0, 0], time_constant * 1000, start_ms, age_ms)
    t, grown = [], []
    for ms in range(0, seconds * 1000, 20):
        warm.step((start_ms + ms) % TICKS)
        t.append(ms / 1000)
        grown.append(warm.drift_q18(0) / 2**18)
    return np.array(t), np.array(grown)


@pytest.mark.parametrize(("c1", "time_constant"), [(4.3, 3816), (-68.0, 600), (1500.0, 30)])
def test_it_is_the_exponential_to_a_thousandth_of_c1(c1, time_constant):
    """In stairs of C1 / 1025, late by T / 1024 at most; the integers miss the end by up to 2^-9 steps."""
    t, grown = course(c1, time_constant, seconds=min(5 * time_constant, 5000))
    exact = -c1 * np.expm1(-t / time_constant)
    print(f"C1 {c1} steps, T {time_constant} s: off by at most {np.abs(grown - exact).max():.4f} steps")
    assert np.abs(grown - exact).max() < abs(c1) * 1.3e-3 + 2**-9


def test_it_is_the_recursion_of_the_float_version():
    """Barshan and Durrant-Whyte, eq. 6, with the same step of T / 1024."""
    c1, time_constant = 68.0, 1024
    _, grown = course(c1, time_constant, seconds=1500)
    theirs = BiasRecursion(WarmupModel(0.0, c1, time_constant), dt=1.0)
    expected = []
    for k in range(1500):
        if k:
            theirs.advance()
        expected.append(theirs.value())
    assert grown[::50] == pytest.approx(np.array(expected), abs=2**-9)


def test_a_node_that_starts_late_or_whose_ticks_begin_anew_goes_on_where_it_is():
    t, grown = course(10.0, 100, seconds=200, age_ms=70_000, start_ms=TICKS - 30_000)
    exact = -10.0 * np.expm1(-(t + 70.0) / 100)
    assert np.abs(grown - exact).max() < 0.015


@pytest.mark.parametrize("age_ms", [-1, 10**9])
def test_a_node_that_has_been_warm_for_long_has_all_of_it(age_ms):
    _, grown = course(10.0, 100, seconds=5, age_ms=age_ms)
    assert np.all(grown == 10.0)


def test_no_intermediate_needs_more_than_31_bits():
    warm = warm_up.WarmUp([SmallInt(1 << 29), SmallInt(-(1 << 29)), SmallInt(5)], SmallInt(100_000_000), 0, 0)
    warm._left = [SmallInt(x) for x in warm._left]
    for ms in range(0, 100_000_000, 97_657):
        warm.step(SmallInt(ms))
    assert abs(warm.drift_q18(0) / 2**29 + math.expm1(-1)) < 1e-3


def test_the_settings_are_in_millionths_of_a_degree_per_second():
    s = {**settings.DEFAULTS, "bias_udps": [-210_000, 0, 29_000_000], "warmup_udps": [300_000, 0, -70_000]}
    known = [bias_choice.known_bias_q18(s, axis, CHIP) / 2**18 for axis in range(3)]
    assert known == pytest.approx([-3.0, 0.0, 29_000 / 70], abs=2**-18)
    PORT_TICKS.now_us = 0.0
    (warm,) = bias_choice.warm_up(s, CHIP, False)
    assert [warm.drift_q18(axis) for axis in range(3)] == [0, 0, 0]
    assert warm._c1 == [round(30 / 7 * 2**18), 0, -(1 << 18)]
    (after,) = bias_choice.warm_up(s, CHIP, True)
    assert after.drift_q18(0) == after._c1[0], "a reset that left the chip its power"
    assert bias_choice.warm_up(settings.DEFAULTS, CHIP, False) == ()
    both = bias_choice.warm_up({**s, "warmup_second": [0, 0, 140_000, 100]}, CHIP, True)
    assert [warm.drift_q18(2) for warm in both] == [-(1 << 18), 2 << 18]
    assert bias_choice.known_bias_q18(settings.DEFAULTS, 0, CHIP) is None
    assert time.ticks_ms() == 0


@pytest.mark.parametrize(
    "bad", [[1, 2], [1, 2, 3, 4], [1.5, 0, 0], ["a", 0, 0], [True, 0, 0], [30_000_001, 0, 0]]
)
def test_a_list_that_makes_no_sense_is_as_if_it_were_not_there(tmp_path, bad):
    import json

    path = tmp_path / "config.json"
    path.write_text(json.dumps({"bias_udps": bad, "warmup_udps": [1, 2, 3], "forgetting_q20": 7}))
    values = settings.load(str(path))
    assert values["bias_udps"] == [] and values["warmup_udps"] == [1, 2, 3]
    assert values["forgetting_q20"] == settings.DEFAULTS["forgetting_q20"]
