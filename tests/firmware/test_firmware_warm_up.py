"""The warm-up on the node: eq. 6 in integers beside the exponential, and the settings that control it."""

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


def run_warm_up(c1, time_constant, *, seconds, age_ms=0, start_ms=0):
    """Return times (N,) in s and the warm-up (N,) in steps of the node, every 20 ms."""
    warm = warm_up.WarmUp([round(c1 * 2**18), 0, 0], time_constant * 1000, start_ms, age_ms)
    t, drift = [], []
    for ms in range(0, seconds * 1000, 20):
        warm.step((start_ms + ms) % TICKS)
        t.append(ms / 1000)
        drift.append(warm.drift_q18(0) / 2**18)
    return np.array(t), np.array(drift)


@pytest.mark.parametrize(("c1", "time_constant"), [(4.3, 3816), (-68.0, 600), (1500.0, 30)])
def test_the_warm_up_agrees_with_the_exponential_to_a_thousandth_of_c1(c1, time_constant):
    """Error bounds: steps of C1 / 1025, a delay of up to T / 1024, and up to 2^-9 gyro steps at the end."""
    t, drift = run_warm_up(c1, time_constant, seconds=min(5 * time_constant, 5000))
    exact = -c1 * np.expm1(-t / time_constant)
    print(f"C1 {c1} steps, T {time_constant} s: off by at most {np.abs(drift - exact).max():.4f} steps")
    assert np.abs(drift - exact).max() < abs(c1) * 1.3e-3 + 2**-9


def test_the_warm_up_agrees_with_the_published_recursion():
    """Compare with eq. 6 of Barshan and Durrant-Whyte, with the same step of T / 1024."""
    c1, time_constant = 68.0, 1024
    _, drift = run_warm_up(c1, time_constant, seconds=1500)
    recursion = BiasRecursion(WarmupModel(0.0, c1, time_constant), dt=1.0)
    expected = []
    for k in range(1500):
        if k:
            recursion.advance()
        expected.append(recursion.value())
    assert drift[::50] == pytest.approx(np.array(expected), abs=2**-9)


def test_the_warm_up_continues_after_a_late_start_and_a_wrap_of_the_ticks():
    t, drift = run_warm_up(10.0, 100, seconds=200, age_ms=70_000, start_ms=TICKS - 30_000)
    exact = -10.0 * np.expm1(-(t + 70.0) / 100)
    assert np.abs(drift - exact).max() < 0.015


@pytest.mark.parametrize("age_ms", [-1, 10**9])
def test_after_a_long_time_the_warm_up_is_complete(age_ms):
    _, drift = run_warm_up(10.0, 100, seconds=5, age_ms=age_ms)
    assert np.all(drift == 10.0)


def test_no_intermediate_needs_more_than_31_bits():
    warm = warm_up.WarmUp([SmallInt(1 << 29), SmallInt(-(1 << 29)), SmallInt(5)], SmallInt(100_000_000), 0, 0)
    warm._left = [SmallInt(x) for x in warm._left]
    for ms in range(0, 100_000_000, 97_657):
        warm.step(SmallInt(ms))
    assert abs(warm.drift_q18(0) / 2**29 + math.expm1(-1)) < 1e-3


def test_the_settings_are_in_millionths_of_a_degree_per_second():
    s = {**settings.DEFAULTS, "bias_udps": [-210_000, 0, 29_000_000], "warmup_udps": [300_000, 0, -70_000]}
    bias_steps = [bias_choice.known_bias_q18(s, axis, CHIP) / 2**18 for axis in range(3)]
    assert bias_steps == pytest.approx([-3.0, 0.0, 29_000 / 70], abs=2**-18)
    PORT_TICKS.now_us = 0.0
    (warm,) = bias_choice.warm_up(s, CHIP, False)
    assert [warm.drift_q18(axis) for axis in range(3)] == [0, 0, 0]
    assert warm._c1 == [round(30 / 7 * 2**18), 0, -(1 << 18)]
    (after,) = bias_choice.warm_up(s, CHIP, True)
    assert after.drift_q18(0) == after._c1[0], "a chip that was not switched off has the complete warm-up"
    assert bias_choice.warm_up(settings.DEFAULTS, CHIP, False) == ()
    both = bias_choice.warm_up({**s, "warmup_second": [0, 0, 140_000, 100]}, CHIP, True)
    assert [warm.drift_q18(2) for warm in both] == [-(1 << 18), 2 << 18]
    assert bias_choice.known_bias_q18(settings.DEFAULTS, 0, CHIP) is None
    assert time.ticks_ms() == 0


@pytest.mark.parametrize(
    "bad", [[1, 2], [1, 2, 3, 4], [1.5, 0, 0], ["a", 0, 0], [True, 0, 0], [30_000_001, 0, 0]]
)
def test_an_invalid_list_is_replaced_by_the_default(tmp_path, bad):
    import json

    path = tmp_path / "config.json"
    path.write_text(json.dumps({"bias_udps": bad, "warmup_udps": [1, 2, 3], "forgetting_q20": 7}))
    values = settings.load(str(path))
    assert values["bias_udps"] == [] and values["warmup_udps"] == [1, 2, 3]
    assert values["forgetting_q20"] == settings.DEFAULTS["forgetting_q20"]
