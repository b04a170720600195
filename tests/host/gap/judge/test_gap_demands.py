"""Demands on the gain of an effect."""

import pytest

from hubodo.gap.judge.demands import is_steady_when_whitened
from hubodo.gap.refit.cross_validation import HeldOutGain
from hubodo.gap.refit.jackknife import JackknifeTest


@pytest.mark.parametrize(
    ("surprise", "agreement_sigmas", "held_out_sigmas", "is_steady"),
    [(12.0, 8.0, 20.0, True), (28.0, 3.0, 20.0, False), (6.0, 8.0, 20.0, False), (12.0, 8.0, 5.0, False)],
)
def test_a_small_effect_needs_agreement_of_all_coordinates_of_one_and_of_held_out_samples(
    surprise, agreement_sigmas, held_out_sigmas, is_steady
):
    held_out = HeldOutGain(50.0 * held_out_sigmas, 50.0, 0.0)
    assert is_steady_when_whitened(JackknifeTest(surprise, agreement_sigmas), held_out) == is_steady
