"""Steps of a bias are found with their time; walks, flicker and warm-ups have none."""

import numpy as np
import pytest

from generators.noise import gyro_noise
from generators.odd_records import ADDED
from hubodo.errors import InputError
from hubodo.sensors.allan.characterise import characterise_noise
from hubodo.sensors.bias_step import find_bias_step
from hubodo.sensors.warmup.characterise import characterise_warmup

NOISE = {"n": 1e-4, "b": 3e-5, "k": 3e-6}


def record(seed, count=1 << 13, dt=0.16):
    rng = np.random.default_rng(seed)
    return np.arange(count) * dt, gyro_noise(count, dt, rng, **NOISE), rng


def test_a_step_is_found_at_its_time_with_its_size():
    """Seeds 0 to 19: steps of twenty times the bias instability."""
    for seed in range(20):
        t, values, rng = record(seed)
        step = ADDED["bias step"](t, rng, 2e-4)
        at = int(np.flatnonzero(step)[0])
        estimate = find_bias_step(t, values + step)
        assert estimate is not None
        assert estimate.t == pytest.approx(t[at], abs=12.0)
        assert estimate.change == pytest.approx(step[-1], abs=1e-4)


@pytest.mark.parametrize("kind", [{"k": 1e-5}, {"b": 3e-5}, NOISE])
def test_noise_has_no_step(kind):
    """Seeds 0 to 39, with a warm-up of a thousand times the noise of a mean."""
    for seed in range(40):
        rng = np.random.default_rng([seed, 9])
        t = np.arange(1 << 13) * 0.16
        warming = 3e-3 * np.exp(-t / rng.uniform(100.0, 600.0))
        assert find_bias_step(t, gyro_noise(len(t), 0.16, rng, **kind) + warming) is None


def test_allan_gives_no_slow_terms_of_a_step_and_warmup_refuses_it():
    t, values, _ = record(3)
    values = values + 4e-4 * (t > 700.0)
    result = characterise_noise(t, values, "gz")
    assert any("the bias steps by +0.02" in note and "at 70" in note for note in result.notes)
    assert result.terms["K"].value is None
    assert "measure that step" in result.terms["B"].reason
    assert result.terms["N"].value == pytest.approx(1e-4, abs=4 * result.terms["N"].sigma)
    with pytest.raises(InputError, match=r"steps by \+0\.02.* deg/s at 699.* no warm-up does; use --end 699"):
        characterise_warmup(t, values, "gz")
