"""Sensors on the rims of a real car turn about the radius twice per revolution, those on the hubs hardly do.

`gap` describes this by an unnamed term. Its amplitude is the same in two drives, so the term is no chance.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path[:0] = [str(Path(__file__).resolve().parent)]

from car import read_car_model, read_drive  # noqa: E402
from test_uneven_noise import LEARNT_ON_DRIVE_1  # noqa: E402

from hubodo.gap.judge.search import build_initial_state  # noqa: E402
from hubodo.gap.problem.build import build_problem  # noqa: E402
from hubodo.gap.refit.refit import refit_with_weights  # noqa: E402

# As `gap` learnt it on drive-2-rim, which shows no unnamed term: its noise is larger.
LEARNT_ON_RIMS = """
[effects.road_bank]
sigma = 0.0752
length = 50.0
[effects.lever_arm]
x = 0.151426
y = -0.001785
[effects.gyro_scale_factor]
z = -0.005267
[effects.accel_bias]
x = 0.1157
z = 0.3627
[nodes.left.effects.node_misalignment]
x = -0.027925
y = -0.015429
[nodes.left.effects.gyro_bias]
x = 0.033818
y = -0.056335
[nodes.right.effects.node_misalignment]
x = -0.089190
y = 0.020185
z = 0.068179
[nodes.right.effects.gyro_bias]
x = 0.025450
y = -0.021784
"""
SPIN = 20.0  # rad/s, nearly the fastest of both drives


def measure_amplitudes(drive, effects, folder):
    """Return the amplitude of cos 2θ in gx of each node, which grows with the spin, in rad/s at `SPIN`."""
    problem = build_problem(read_drive(drive), read_car_model(folder, effects))
    fit = refit_with_weights(build_initial_state(problem))
    amplitudes = {}
    for name, residual in fit.evaluation.mean_residuals.items():
        rolling = fit.state.predictions[name].rolling
        angles = np.outer([1.0, 2.0, 3.0], rolling.angle)
        columns = np.concatenate([np.ones((1, len(rolling.spin))), np.cos(angles), np.sin(angles)])
        value = residual.value[0] - fit.evaluation.input_noise_residuals[name][0]
        coefficients, *_ = np.linalg.lstsq((columns * rolling.spin / SPIN).T, value, rcond=None)
        amplitudes[name] = float(coefficients[2])
    return amplitudes


@pytest.mark.repeat
def test_the_rims_tilt_twice_per_revolution_by_as_much_in_both_drives(tmp_path):
    rims = [measure_amplitudes(drive, LEARNT_ON_RIMS, tmp_path) for drive in ("drive-1-rim", "drive-2-rim")]
    hubs = measure_amplitudes("drive-1", LEARNT_ON_DRIVE_1, tmp_path)
    for name in ("left", "right"):
        first, second = (one[name] for one in rims)
        print(f"{name}: rims {1e3 * first:.1f} and {1e3 * second:.1f}, hub {1e3 * hubs[name]:.1f} mrad/s")
        assert first == pytest.approx(second, rel=0.25) and abs(first) > 1.5 * abs(hubs[name])
