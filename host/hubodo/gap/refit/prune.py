"""Pruning of coordinates that a log with correlated residuals does not determine."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.empirical import PREFIX
from hubodo.effects.plausibility import implausible_parameters
from hubodo.gap.process_noise.residual import compute_gap
from hubodo.gap.refit.cross_validation import compute_level_scatter, sum_folds
from hubodo.gap.refit.linear_fit import Refit
from hubodo.gap.refit.refit import compute_model_gain, refit
from hubodo.gap.state.terms import ALL, ModelTerm, terms_of_model

# Total loss in ln likelihood that pruning may cost, in sigma due to a noise level that varies along the
# drive.
_MAX_LOSS_LEVEL_SIGMAS = 0.3
# Relative error of the change of the readings by the model's own effects, which flex, age and warm up: what
# they leave looks like other effects and coordinates. Without it, uneven noise is no reason for doubt.
MODEL_IMPRECISION = 0.05
# Loss in ln likelihood, tempered, up to which a coordinate is due to chance: 3 sigma.
_MAX_CHANCE_LOSS = 0.5 * 3.0**2
# Largest ratio of the gap after pruning to that before it.
_MAX_GAP_RATIO = 1.01


def prune_coordinates(fit: Refit) -> Refit:
    """Return the fit with undetermined coordinates at zero, or as in the model file, all others fitted again.

    Of an effect with several parameters, such as a lever arm, a log often determines only some. The others
    fit irregularities of the road that no effect describes, and would be wrong on the next drive. In white
    noise nothing is pruned. Coordinates at their plausible limit are removed first, then those that cost
    least (backward elimination).
    """
    candidates, at_limit = _list_candidates(fit, fit.free_terms)
    if not candidates or fit.tempering <= 1.0:
        return fit
    budget = _max_losses(fit, fit.tempering, compute_model_gain(fit), _channel_doubts(fit))
    if not budget[candidates].any():
        return fit
    pruned, _loss = _eliminate(candidates, at_limit, fit.covariance, _relative_coordinates(fit), budget)
    max_gap = _MAX_GAP_RATIO * compute_gap(fit.without_cache().evaluation.residuals)
    for selected in (pruned, [k for k in pruned if k in at_limit]):
        terms = [_freeze(term, fit, selected) for term in fit.state.terms]
        if selected:
            result = refit(fit.evaluation.with_state(fit.state.with_terms(terms)))
            if compute_gap(result.without_cache().evaluation.residuals) <= max_gap:
                return _with_doubt_of_pruned(result, fit, selected)
    return fit


def _with_doubt_of_pruned(result: Refit, fit: Refit, pruned: Sequence[int]) -> Refit:
    """Return a fit whose covariances contain that of the coordinates which pruning set to zero.

    A log may determine only the difference of two scale errors. If one of them is set to zero, the other has
    the whole difference, and is no better known than before.

    result, fit: after and before pruning
    """
    inverse = np.linalg.pinv(fit.covariance[np.ix_(pruned, pruned)], hermitian=True)
    shift = fit.covariance[:, pruned] @ inverse
    shift[list(pruned)] = 0.0
    added, robust = (
        shift @ covariance[np.ix_(pruned, pruned)] @ shift.T
        for covariance in (fit.covariance, fit.robust_covariance)
    )
    return replace(
        result,
        covariance=result.covariance + added,
        robust_covariance=result.robust_covariance + robust,
    )


def count_determined(fit: Refit, term: ModelTerm, tempering: float, model_gain: float) -> tuple[int, float]:
    """Return the number of coordinates that pruning would leave of a free term, and its loss.

    tempering: factor by which correlated residuals exaggerate likelihoods
    model_gain: gain of all effects of the fit, in ln likelihood
    """
    candidates, at_limit = _list_candidates(fit, [term])
    budget = _max_losses(fit, tempering, model_gain, np.ones(len(fit.covariance)))
    pruned, loss = _eliminate(candidates, at_limit, fit.covariance, _relative_coordinates(fit), budget)
    return len(term.effect.coordinates()) - len(pruned), loss


def _max_losses(fit: Refit, tempering: float, model_gain: float, level_shares: Array) -> Array:
    """Return the largest losses in ln likelihood that pruning may cost up to each coordinate, (K,).

    level_shares: (K,) shares of the coordinates in the doubt about the level of the noise
    """
    level = 0.5 * _MAX_LOSS_LEVEL_SIGMAS * fit.fold_deviances.level_scatter * level_shares
    doubt = max(MODEL_IMPRECISION**2 * model_gain, fit.given_gain, _MAX_CHANCE_LOSS * tempering)
    return np.asarray((1.0 - 1.0 / tempering) * np.minimum(level, doubt))


def _channel_doubts(fit: Refit) -> Array:
    """Return the share of each coordinate, (K,), in the doubt about the level of the noise.

    A bias of an accelerometer is not in doubt because a gyro slips in turns: only the channels count that the
    coordinate changes.
    """
    assert fit.channel_shares is not None
    evaluation = fit.without_cache().evaluation
    squares, samples = sum_folds(evaluation.squares_per_block()), sum_folds(evaluation.samples_per_block())
    scatter = [compute_level_scatter(squares @ share, samples @ share) for share in fit.channel_shares]
    return np.minimum(np.array(scatter) / max(fit.fold_deviances.level_scatter, 1e-300), 1.0)


def _eliminate(
    candidates: Sequence[int], at_limit: Collection[int], covariance: Array, value: Array, budget: Array
) -> tuple[list[int], float]:
    """Return the coordinates that cost least, up to a budget, and their total loss (backward elimination).

    candidates: indices of the coordinates that may be pruned; those in `at_limit` are first, at any cost
    covariance: (K, K), value: (K,), and budget: (K,), of all coordinates
    """
    remaining, pruned, total, spent = list(candidates), list[int](), 0.0, 0.0
    while remaining:
        variance = covariance[remaining, remaining]
        loss = np.where(variance > 0.0, 0.5 * value[remaining] ** 2 / np.maximum(variance, 1e-300), 0.0)
        is_at_limit = np.array([k in at_limit for k in remaining])
        is_affordable = is_at_limit | (spent + loss < budget[remaining])
        if not is_affordable.any():
            break
        weakest = int(np.argmin(np.where(is_affordable, np.where(is_at_limit, -1.0, loss), np.inf)))
        total += float(loss[weakest])
        spent += 0.0 if is_at_limit[weakest] else float(loss[weakest])
        k = remaining.pop(weakest)
        pruned.append(k)
        if covariance[k, k] > 0.0:
            gain = covariance[:, k] / covariance[k, k]
            value = value - gain * value[k]
            covariance = covariance - np.outer(gain, covariance[k])
    return pruned, total


def _list_candidates(fit: Refit, terms: Sequence[ModelTerm]) -> tuple[list[int], set[int]]:
    """Return the coordinates that may be pruned, of effects with several parameters, and those at a limit."""
    indices: list[int] = []
    at_limit: set[int] = set()
    for term in terms:
        effect, names = term.effect, term.effect.fitted_parameters()
        is_plain = len(names) == len(effect.coordinates()) > 1
        starts_at_zero = not any(guess.coordinates().any() for guess in effect.initial_guesses())
        if is_plain and starts_at_zero and not effect.name.startswith(PREFIX):
            place = fit.coordinate_slice(term)
            indices += range(place.start, place.stop)
            at_limit |= {place.start + names.index(name) for name in implausible_parameters(effect)}
    return indices, at_limit


def _relative_coordinates(fit: Refit) -> Array:
    """Return the coordinates of all free terms, (K,), less those of the model file, in scales."""
    values = [
        (term.effect.coordinates() - given_coordinates(fit, term)) / term.effect.coordinate_scales()
        for term in fit.free_terms
    ]
    return np.concatenate(values) if values else np.empty(0)


def given_coordinates(fit: Refit, term: ModelTerm) -> Array:
    """Return the coordinates of an effect in the model file, of its scope or of all; zeros if it has none."""
    given = {one.key: one.effect.coordinates() for one in terms_of_model(fit.state.problem.model)}
    return given.get(term.key, given.get((term.effect.name, ALL), np.zeros(len(term.effect.coordinates()))))


def _freeze(term: ModelTerm, fit: Refit, pruned: Collection[int]) -> ModelTerm:
    """Return a term with its pruned coordinates frozen; a new effect keeps at least one."""
    if not term.is_refittable:
        return term
    place = fit.coordinate_slice(term)
    frozen = tuple(k - place.start for k in range(place.start, place.stop) if k in pruned)
    coordinates, given = term.effect.coordinates(), given_coordinates(fit, term)
    if not frozen or (len(frozen) == len(coordinates) and not given.any()):
        return term
    coordinates[list(frozen)] = given[list(frozen)]
    return replace(term.with_coordinates(coordinates), frozen=frozen)
