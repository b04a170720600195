"""Two logs with common and separate coordinates: only a difference of the logs is a change."""

from types import SimpleNamespace

import numpy as np
import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.change.joint import join_logs
from hubodo.gap.refit.cross_validation import compute_held_out_gain
from hubodo.gap.screen.candidates import Candidate
from hubodo.gap.state.terms import ModelTerm

N_BLOCKS, N_SAMPLES, SEED = 24, 40, 11
BIAS = Candidate(ModelTerm(BY_NAME["gyro_bias"](), "left"), np.eye(3))


def linear_log(coordinates, rng):
    """Return a log of unit noise whose residual has these coordinates, (3,), along random directions."""
    columns = rng.normal(size=(N_BLOCKS, N_SAMPLES, 3))
    residual = columns @ np.asarray(coordinates) + rng.normal(size=(N_BLOCKS, N_SAMPLES))
    rows = np.concatenate([columns, residual[:, :, None]], axis=2)
    blocks = np.swapaxes(rows, 1, 2) @ rows
    samples = np.full(N_BLOCKS, float(N_SAMPLES))
    return SimpleNamespace(
        evaluation=SimpleNamespace(samples_per_block=lambda: samples[:, None]),
        terms=(),
        candidates=(BIAS,),
        n_directions=3,
        blocks=blocks,
        raw_squares=np.diag(blocks.sum(axis=0))[:3],
        log_determinant=0.0,
    )


def gains(before, after):
    """Return the gain of a value for each log over a common one: fitted, held out, and the change."""
    rng = np.random.default_rng(SEED)
    joint = join_logs(linear_log(before, rng), linear_log(after, rng), (), 1.0)
    common, separate = joint.fit_candidate(BIAS, is_known=False)
    held_out = compute_held_out_gain(common.fold_deviances, separate.fold_deviances)
    return 0.5 * (common.objective - separate.objective), held_out.total, separate.step[-3:]


def test_what_both_logs_lack_is_no_change():
    gain, held_out, change = gains((0.5, -0.3, 0.0), (0.5, -0.3, 0.0))
    assert gain < 8.0 and held_out < 4.0
    assert change == pytest.approx(np.zeros(3), abs=0.15)


def test_a_difference_of_the_logs_is_a_change_also_on_samples_that_were_not_fitted():
    gain, held_out, change = gains((0.5, -0.3, 0.0), (0.5, 0.1, 0.0))
    # 24 × 40 samples of unit noise in each log: 0.4² · 960 / 4 = 38 in ln likelihood.
    assert 25.0 < gain < 55.0 and held_out > 20.0
    assert change == pytest.approx((0.0, 0.4, 0.0), abs=0.15)
