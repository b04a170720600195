"""How sure a name is: a posterior over the candidates, nothing, and something that is not listed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import exp, log

import numpy as np
from scipy.special import logsumexp

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.rival import Rival

# Prior: as likely as not that nothing is missing. What is missing is mostly in the list; a term of a library
# that does no better than an effect with a name is that effect.
NOTHING, UNLISTED = log(0.5), log(1e-6)
_LISTED = log(0.5)
# Where such a term does better by more than this, in ln likelihood, it is not that effect: then it is as
# likely as that something is missing which is not in the list.
NEAR, _MISSING_FROM_LIST = 3.0, log(0.05)


def judged(rivals: Sequence[Rival]) -> tuple[tuple[Rival, ...], float]:
    """The rivals with their probabilities, the most probable first, and that of nothing."""
    names = [rival.term.effect.name for rival in rivals]
    prior = [
        UNLISTED if name.startswith(PREFIX) else one for name, one in zip(names, _priors(names), strict=True)
    ]
    scores = {str(k): rival.evidence + prior[k] for k, rival in enumerate(rivals)}
    share = _posterior({**scores, "nothing": NOTHING})
    made = [replace(rival, probability=share[str(k)]) for k, rival in enumerate(rivals)]
    return tuple(sorted(made, key=lambda it: -it.probability)), share["nothing"]


def by_name(rivals: Sequence[Rival], own: Rival | None) -> dict[str, float]:
    """The probability of each name, its scopes together, with doubt in the list where `own` fits worse."""
    shares: dict[str, float] = {}
    for rival in rivals:
        name = rival.term.effect.name
        better = own is not None and name.startswith(PREFIX) and rival.gain > own.gain + NEAR
        doubt = exp(_MISSING_FROM_LIST - UNLISTED) if better and rival is not own else 1.0
        shares[name] = shares.get(name, 0.0) + doubt * rival.probability
    total = max(sum(shares.values()), 1.0)
    return {name: share / total for name, share in shares.items()}


def _priors(names: Sequence[str]) -> Array:
    """(len(names),) ln prior of candidates: every effect alike, its scopes and seeds share."""
    return np.array([_LISTED - log(len(BY_NAME)) - log(names.count(name)) for name in names])


def _posterior(scores: Mapping[str, float]) -> dict[str, float]:
    """Probabilities from ln posteriors that are not normalised."""
    values = np.array(list(scores.values()))
    return dict(zip(scores, np.exp(values - logsumexp(values)).tolist(), strict=True))
