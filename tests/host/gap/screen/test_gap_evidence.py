"""Evidence of candidates, and posterior probabilities by effect name."""

import numpy as np
import pytest

from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX, empirical_class
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.judge.posterior import compute_posterior, sum_by_name
from hubodo.gap.screen.evidence import compute_log_evidence
from hubodo.gap.state.terms import ModelTerm

SEED = 31


def build_hypothesis(name, gain, evidence, scope="left"):
    kind = empirical_class(name) if name.startswith(PREFIX) else BY_NAME[name]
    return Hypothesis(ModelTerm(kind(), scope), gain, evidence, 0.0)


@pytest.mark.parametrize("count", [1, 3])
def test_evidence_does_not_depend_on_the_typical_size_of_an_effect(count):
    """The gain is the same for coordinates of 1, 1/30 and 1/1000 of the typical size."""
    significance = 8.0
    log_evidence = []
    for scale in (1.0, 1.0 / 30.0, 1e-3):
        value = np.full(count, scale / np.sqrt(count))
        log_evidence.append(
            compute_log_evidence(0.5 * significance**2, value, np.eye(count) * (significance / scale) ** 2)
        )
    print(log_evidence)
    assert np.ptp(log_evidence) < 1.0


def test_an_insignificant_gain_is_no_evidence():
    assert compute_log_evidence(2.5, np.array([0.1]), np.array([[500.0]])) < 0.5


def test_an_empirical_term_counts_for_the_equivalent_effect_unless_it_fits_better():
    term = f"{PREFIX}gz ~ spin"
    equal_fit, _ = compute_posterior(
        [build_hypothesis("gyro_scale_factor", 100.0, 90.0), build_hypothesis(term, 100.0, 92.0)]
    )
    better_fit, _ = compute_posterior(
        [build_hypothesis("gyro_scale_factor", 100.0, 90.0), build_hypothesis(term, 112.0, 104.0)]
    )
    probabilities = [
        sum_by_name(it, next(one for one in it if one.gain == 100.0)) for it in (equal_fit, better_fit)
    ]
    assert probabilities[0]["gyro_scale_factor"] > 0.99
    assert probabilities[1]["gyro_scale_factor"] < 0.1
