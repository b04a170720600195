"""Values of an effect in two logs, with sigmas from their joint fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hubodo.gap.change.difference import LogPair, free_all_terms
from hubodo.gap.change.joint import FROZEN_VARIANCE, EffectKey, JointFit, JointGrams, join_logs, linearise_log
from hubodo.gap.explain.finding import estimate_parameters
from hubodo.gap.explain.result import Estimate
from hubodo.gap.linear.directions import move_terms
from hubodo.gap.refit.linear_fit import Refit


def estimate_change(pair: LogPair, key: EffectKey) -> dict[str, tuple[Estimate, Estimate, Estimate]]:
    """Return for each parameter of an effect its value before and after, and the change."""
    logs = [linearise_log(free_all_terms(one), with_candidates=False) for one in pair.evaluations]
    joint = join_logs(logs[0], logs[1], pair.separate, pair.tempering)
    best = joint.fit()
    estimates = []
    for number in range(2):
        fit = _refit_of_log(joint, best, number)
        term = next(one for one in fit.free_terms if one.key == key)
        step = best.step[joint.indices[number]][fit.coordinate_slice(term)]
        (shifted,) = move_terms([term], [step])
        estimates.append(estimate_parameters(shifted, fit))
    return {
        name: (before, after, _subtract(before, after))
        for (name, before), after in zip(estimates[0].items(), estimates[1].values(), strict=True)
    }


def _subtract(before: Estimate, after: Estimate) -> Estimate:
    known = before.sigma is not None and after.sigma is not None
    sigma = float(np.hypot(before.sigma or 0.0, after.sigma or 0.0)) if known else None
    return Estimate(after.value - before.value, sigma, before.unit)


def _refit_of_log(joint: JointGrams, best: JointFit, number: int) -> Refit:
    """Return the part of a joint fit that concerns one log."""
    log, place = joint.logs[number], joint.indices[number]
    prior = replace(best.prior, information=best.prior.information[place], value=best.prior.value[place])
    square = np.ix_(place, place)
    count = sum(len(term.effect.coordinates()) for term in log.terms)
    is_free = np.diag(best.covariance)[place] > FROZEN_VARIANCE
    covariance, robust = (
        part[square] * np.outer(is_free, is_free) for part in (best.covariance, best.robust_covariance)
    )
    return Refit(
        log.evaluation,
        log.terms,
        covariance[:count, :count],
        robust[:count, :count],
        best.deviance,
        best.block_scores[:, place[:count]],
        covariance,
        best.gram[np.ix_([*place, -1], [*place, -1])],
        best.folds,
        prior,
    )
