"""Noise of a road in half a drive, whose few blocks show no correlation, names nothing.

The model is that of another drive. On the second half of drive-2 it differs by 0.5 mrad in a misalignment.
"""

import sys
from pathlib import Path

import pytest

sys.path[:0] = [str(Path(__file__).resolve().parent)]

from car import read_car_model, read_drive  # noqa: E402
from variants import read_variant  # noqa: E402

from hubodo.gap.judge.round import judge_round  # noqa: E402
from hubodo.gap.judge.search import build_initial_state  # noqa: E402
from hubodo.gap.problem.build import build_problem  # noqa: E402
from hubodo.gap.refit.refit import refit_with_weights  # noqa: E402

# As `gap` learnt it on drive-1.
LEARNT_ON_DRIVE_1 = """
[effects.road_bank]
sigma = 0.0189
length = 158.0
[effects.wheel_camber]
angle = 0.03384
[effects.gyro_scale_factor]
z = -0.005016
[nodes.left.effects.lever_arm]
x = 0.006767
y = -0.010221
[nodes.left.effects.node_misalignment]
x = 0.002737
y = 0.019016
[nodes.left.effects.gyro_bias]
x = -0.055576
y = -0.051062
z = -0.006783
[nodes.right.effects.lever_arm]
x = 0.002125
y = -0.005425
[nodes.right.effects.node_misalignment]
x = -0.013175
y = -0.005231
[nodes.right.effects.gyro_bias]
x = 0.038693
y = 0.007659
z = 0.020854
"""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return read_car_model(tmp_path_factory.mktemp("model"), LEARNT_ON_DRIVE_1)


@pytest.fixture(scope="module")
def fit(model):
    return refit_with_weights(build_initial_state(build_problem(read_drive("drive-2/second"), model)))


def test_a_road_that_is_uneven_lets_given_effects_differ_though_its_blocks_show_no_correlation(fit):
    given = fit.prior.is_free[fit.given_indices]
    print(f"tempering {fit.tempering}, {given.sum()} of {len(given)} coordinates of given effects free")
    assert fit.tempering >= 3.5 and given.sum() > len(given) // 2


@pytest.mark.repeat
def test_noise_of_half_a_drive_is_no_effect(fit):
    judged = judge_round(fit.evaluation)
    first = judged.hypotheses[0]
    print(f"first hypothesis {first.key}: gain {first.gain:.0f}, {first.objection}")
    assert judged.best is None and judged.provisional is None


@pytest.mark.repeat
def test_a_drive_at_a_third_of_its_rate_shows_no_random_walk(model):
    """At 40 Hz vibration is aliased into the means of the gyros, which drift as much as a random walk."""
    _drive, recording = read_variant("40_hz")
    judged = judge_round(refit_with_weights(build_initial_state(build_problem(recording, model))).evaluation)
    print(f"first hypothesis {judged.hypotheses[0].key}, nothing missing {judged.null_probability:.3f}")
    assert judged.best is None
