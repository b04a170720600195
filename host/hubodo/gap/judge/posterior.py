"""Posterior over all candidates, the null hypothesis, and effects outside the list."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import exp, log

import numpy as np
from scipy.special import logsumexp

from hubodo.arrays import Array
from hubodo.effects import count_fitted_effects
from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.hypothesis import Hypothesis

# Prior: nothing is missing with probability 0.5. Missing effects are mostly in the list; a library term that
# fits no better than a listed effect is that effect.
LOG_PRIOR_NOTHING, LOG_PRIOR_UNNAMED = log(0.5), log(1e-6)
_LOG_PRIOR_LISTED = log(0.5)
# A library term that gains this much more ln likelihood than a listed effect is another effect: its prior is
# the probability that the list of effects is incomplete.
MAX_SIMILAR_GAIN, _LOG_PRIOR_LIST_INCOMPLETE = 3.0, log(0.05)


def compute_posterior(hypotheses: Sequence[Hypothesis]) -> tuple[tuple[Hypothesis, ...], float]:
    """Return the hypotheses by descending probability, and the probability of the null hypothesis."""
    names = [hypothesis.term.effect.name for hypothesis in hypotheses]
    prior = [
        LOG_PRIOR_UNNAMED if name.startswith(PREFIX) else log_prior
        for name, log_prior in zip(names, _log_priors(names), strict=True)
    ]
    scores = {str(k): hypothesis.evidence + prior[k] for k, hypothesis in enumerate(hypotheses)}
    probabilities = _normalise({**scores, "nothing": LOG_PRIOR_NOTHING})
    judged = [
        replace(hypothesis, probability=probabilities[str(k)]) for k, hypothesis in enumerate(hypotheses)
    ]
    return tuple(sorted(judged, key=lambda hypothesis: -hypothesis.probability)), probabilities["nothing"]


def sum_by_name(hypotheses: Sequence[Hypothesis], own: Hypothesis | None) -> dict[str, float]:
    """Return the probability of each effect, summed over its scopes.

    An unnamed term that fits better than `own` counts with the prior of an incomplete list.
    """
    probabilities: dict[str, float] = {}
    for hypothesis in hypotheses:
        name = hypothesis.term.effect.name
        is_better = (
            own is not None and name.startswith(PREFIX) and hypothesis.gain > own.gain + MAX_SIMILAR_GAIN
        )
        prior_ratio = (
            exp(_LOG_PRIOR_LIST_INCOMPLETE - LOG_PRIOR_UNNAMED)
            if is_better and hypothesis is not own
            else 1.0
        )
        probabilities[name] = probabilities.get(name, 0.0) + prior_ratio * hypothesis.probability
    total = max(sum(probabilities.values()), 1.0)
    return {name: share / total for name, share in probabilities.items()}


def _log_priors(names: Sequence[str]) -> Array:
    """Return ln prior of candidates, (len(names),): equal for all effects, shared among scopes and seeds."""
    return np.array(
        [_LOG_PRIOR_LISTED - log(count_fitted_effects()) - log(names.count(name)) for name in names]
    )


def _normalise(scores: Mapping[str, float]) -> dict[str, float]:
    """Return probabilities from unnormalised ln posteriors."""
    values = np.array(list(scores.values()))
    return dict(zip(scores, np.exp(values - logsumexp(values)).tolist(), strict=True))
