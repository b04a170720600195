"""Evidence and confidence: what they hang on, and what they must not hang on."""

import numpy as np
import pytest

from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX, empirical
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.judge.posterior import compute_posterior, sum_by_name
from hubodo.gap.screen.evidence import compute_log_evidence
from hubodo.gap.state.terms import ModelTerm

SEED = 31


def rival(name, gain, evidence, scope="left"):
    kind = empirical(name) if name.startswith(PREFIX) else BY_NAME[name]
    return Hypothesis(ModelTerm(kind(), scope), gain, evidence, 0.0)


@pytest.mark.parametrize("count", [1, 3])
def test_two_names_that_fit_alike_are_alike_likely_whatever_their_usual_sizes(count):
    """The same gain by coordinates that are usual in size, a thirtieth, and a thousandth of that."""
    sigmas = 8.0
    made = []
    for size in (1.0, 1.0 / 30.0, 1e-3):
        value = np.full(count, size / np.sqrt(count))
        made.append(compute_log_evidence(0.5 * sigmas**2, value, np.eye(count) * (sigmas / size) ** 2))
    print(made)
    assert np.ptp(made) < 1.0


def test_nothing_is_no_evidence():
    assert compute_log_evidence(2.5, np.array([0.1]), np.array([[500.0]])) < 0.5


def test_structure_without_a_name_counts_where_it_fits_better_and_else_is_the_effect():
    term = f"{PREFIX}gz ~ spin"
    alike, _ = compute_posterior([rival("gyro_scale_factor", 100.0, 90.0), rival(term, 100.0, 92.0)])
    better, _ = compute_posterior([rival("gyro_scale_factor", 100.0, 90.0), rival(term, 112.0, 104.0)])
    found = [sum_by_name(it, next(one for one in it if one.gain == 100.0)) for it in (alike, better)]
    assert found[0]["gyro_scale_factor"] > 0.99
    assert found[1]["gyro_scale_factor"] < 0.1
