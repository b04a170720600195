"""All scatter detectors: no proposal without a cause, none for an effect in the model."""

from dataclasses import replace

import numpy as np
import pytest

from gap_residuals import SEEDS, SIGMA, repeated, shown, walking, white
from hubodo.gap.scatter.limits import detect_limits
from hubodo.gap.scatter.outliers import detect_outliers, find_spiky_channels
from hubodo.gap.scatter.quantization import detect_quantization
from hubodo.gap.scatter.random_walk import detect_random_walk
from hubodo.gap.scatter.repeats import detect_repeats


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_is_proposed_where_noise_is_all_there_is(seed):
    clean, y = white(np.random.default_rng(seed))
    one = shown(y, clean)
    for look in (
        detect_limits,
        detect_outliers,
        detect_quantization,
        detect_random_walk,
        detect_repeats,
    ):
        assert look([one, replace(one, node=replace(one.node, name="right"))]) == [], look.__name__
    assert find_spiky_channels(one) == []


def test_what_the_model_has_already_is_not_proposed_again():
    rng = np.random.default_rng(1)
    clean, y = walking(rng, 0.003)
    assert detect_random_walk([shown(y, clean, effects=["gyro_rate_random_walk"])]) == []
    clean, y, fresh = repeated(rng, 0.02, 0.3 * SIGMA)
    assert detect_repeats([shown(y, clean, fresh=fresh, effects=["sample_repeat"])]) == []
    clean, y = white(rng)
    y = np.clip(0.04 * np.round(y / 0.04), -5.0, 5.0)
    known = ["gyro_quantization", "gyro_saturation", "accel_saturation"]
    one = shown(y, clean, limits=(5.0, 5.0), effects=known)
    assert detect_limits([one]) == detect_quantization([one]) == []
