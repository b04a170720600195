"""Effects that the residual of the final model would show by chance."""

from types import SimpleNamespace

import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.judge import chance_effects
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.refit.cross_validation import HeldOutGain
from hubodo.gap.state.terms import ModelTerm


@pytest.mark.parametrize(
    ("tempering", "last_tempering", "held_out", "is_dropped"),
    [
        (1.0, 13.5, 33.0, True),
        (1.0, 13.5, 1400.0, False),
        (1.0, 1.5, 33.0, False),
        (5.0, 13.5, 33.0, False),
        # Confirmed, but by no more than an uneven level of the noise gains.
        (1.0, 40.0, 900.0, True),
    ],
)
def test_a_drift_that_no_held_out_sample_confirms_is_dropped_where_residuals_are_correlated(
    monkeypatch, tempering, last_tempering, held_out, is_dropped
):
    """A random walk of a gyro between standstills, through which a warm-up passes."""
    monkeypatch.setattr(chance_effects, "refit_with_weights", lambda state: state)
    monkeypatch.setattr(Hypothesis, "p_value", lambda self, distribution: 0.0)
    term = ModelTerm(BY_NAME["gyro_warmup"](), "right")
    gain = HeldOutGain(held_out, 333.0, 1832.7)
    warmup = Hypothesis(term, 1469.6, 1450.6, 1.0, "fitted", held_out_gain=gain)
    judged = SimpleNamespace(tempering=tempering, find_hypothesis=lambda key: warmup)
    last = SimpleNamespace(tempering=last_tempering, null_distribution=None)
    state = SimpleNamespace(terms=[term], without_terms=lambda keys: list(keys))
    result = SearchResult((judged, last), SimpleNamespace(state=state))
    reduced, _rounds = chance_effects.drop_chance_effects(result, {term.key: judged})
    assert (reduced.final == [term.key]) == is_dropped
