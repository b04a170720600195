"""All scatter detectors: no proposal for white noise, none for an effect that the model has."""

from dataclasses import replace

import numpy as np
import pytest

from gap_residuals import (
    SEEDS,
    SIGMA,
    build_residual,
    draw_readings,
    draw_readings_with_repeats,
    draw_readings_with_walk,
)
from hubodo.gap.scatter.limits import detect_limits
from hubodo.gap.scatter.outliers import detect_outliers, find_spiky_channels
from hubodo.gap.scatter.quantization import detect_quantization
from hubodo.gap.scatter.random_walk import detect_random_walk
from hubodo.gap.scatter.repeats import detect_repeats


@pytest.mark.parametrize("seed", SEEDS)
def test_no_detector_proposes_an_effect_for_white_noise(seed):
    clean, y = draw_readings(np.random.default_rng(seed))
    residual = build_residual(y, clean)
    for detect in (
        detect_limits,
        detect_outliers,
        detect_quantization,
        detect_random_walk,
        detect_repeats,
    ):
        assert detect([residual, replace(residual, node=replace(residual.node, name="right"))]) == [], (
            detect.__name__
        )
    assert find_spiky_channels(residual) == []


def test_effects_of_the_model_are_not_proposed_again():
    rng = np.random.default_rng(1)
    clean, y = draw_readings_with_walk(rng, 0.003)
    assert detect_random_walk([build_residual(y, clean, effects=["gyro_rate_random_walk"])]) == []
    clean, y, is_new = draw_readings_with_repeats(rng, 0.02, 0.3 * SIGMA)
    assert detect_repeats([build_residual(y, clean, is_new=is_new, effects=["sample_repeat"])]) == []
    clean, y = draw_readings(rng)
    y = np.clip(0.04 * np.round(y / 0.04), -5.0, 5.0)
    effects = ["gyro_quantization", "gyro_saturation", "accel_saturation"]
    residual = build_residual(y, clean, limits=(5.0, 5.0), effects=effects)
    assert detect_limits([residual]) == detect_quantization([residual]) == []
