"""Selection of the standstills among quiet segments: their rates are one slowly drifting bias.

A vertical gyro that turns at a steady rate measures a constant, as one at standstill does. Each hypothesis
names the segments that are standstills (or none). Standstills share one bias, whose prior is narrow; the rate
of a steady turn has a uniform prior up to the largest rate of the record. Gravity and Earth rate contribute
the likelihood of each bias, because on a table that is not exactly level they turn with the heading (module
`turn_evidence`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln, logsumexp

from hubodo.arrays import Array
from hubodo.sensors.heading.quiet_segments import QuietSegments

MIN_ODDS = 20.0
"""Odds against all other hypotheses from which a standstill is accepted."""
SURE_ODDS = 1000.0
"""Odds from which it needs no remark."""
_CONFIRMING_RATIO = 10.0
"""Likelihood ratio from which gravity or Earth rate confirms a bias, against the mean over its prior."""
_BIAS_SIGMAS, _BIAS_WEIGHTS = np.radians([0.1, 0.3, 1.0, 4.0]), np.array([0.05, 0.2, 0.5, 0.25])
"""Prior of the bias: 1σ, rad/s, from the offset of a tactical to that of a cheap MEMS gyro, and weights.

The other axes of the gyro are further examples of its bias and change the weights.
"""
_MIN_TURN_RATE = np.radians(2.0)
"""Steady turns are at least as fast as this, rad/s, in some part of a record."""
_MAX_SLOW_RATE = np.radians(5.0)
"""Largest rate, rad/s, of a record whose steady turns are as slow as the bias of a gyro: none is accepted."""
_MAX_TURN_LENGTH_RATIO = 3.0
"""A steady turn is at most this much longer than the longest standstill, else none is accepted.

Straight stretches of a drive last a second or two and share the rate of a slight curve of the road.
"""
_MIN_SOLE_LENGTH_RATIO = 1.2
"""A sole standstill that begins the record and exceeds every steady turn by this ratio needs no confirmation.

Among ten turns of its own length, one has by chance the small rate of a bias in every fifth record.
"""
_STANDSTILL_COUNT, _TURN_COUNT = 8.0, 0.4
"""Parameters of the beta prior of the share of quiet segments that are standstills."""
_START_ODDS = 25.0
"""Odds that a record which begins with a constant rate begins with a standstill."""
_RATE_JITTER, _RATE_WALK = np.radians(0.01), np.radians(0.002)
"""Bias instability between standstills, rad/s, and rate random walk, rad/s/√s, of a MEMS gyro."""
_MAX_DRIFT_RATE, _MIN_DRIFT_RATE = np.radians(0.002), np.radians(1e-5)
"""Largest and smallest 1σ of the drift rate, rad/s². 0.05 deg/s/K and 10 K in five minutes are 0.0017."""
_SAME_BIAS, _SAME_DRIFTING_BIAS = np.radians(0.03), np.radians(0.1)
"""Hypotheses whose biases differ by less lead to the same heading: biases walk as far in five minutes.

The second value is for sets of which one contains the other: their mean times differ, and with them the bias
of a gyro that warms up.
"""
_SAME_TURN_RATE = 0.1
"""Probability that a steady turn repeats the rate of another one, as the programmes of tables do."""
MAX_BIAS = np.radians(12.0)
"""rad/s; offsets of MEMS gyros are smaller."""
_MAX_SEGMENTS = 80
"""Longest segments that take part in the decision."""


@dataclass(frozen=True)
class StandstillChoice:
    """The segments that are standstills.

    Attributes:
        is_standstill: (K,) for each segment.
        bias: mean rate of the standstills, rad/s.
        odds: odds against all hypotheses with another bias.
        alternative: the most probable other hypothesis; no segment if that is a record without standstill.
        needed_odds: odds from which on the standstills are accepted.
    """

    is_standstill: NDArray[np.bool_]
    bias: float
    odds: float
    alternative: NDArray[np.bool_]
    needed_odds: float = MIN_ODDS

    @property
    def is_accepted(self) -> bool:
        """Return True if the standstills are probable enough."""
        return bool(self.is_standstill.any()) and self.odds >= self.needed_odds


def choose_standstills(
    segments: QuietSegments,
    largest_rate: float,
    latest_start: int,
    other_biases: Array,
    log_evidence: Callable[[Array], Array] | None = None,
) -> StandstillChoice:
    """Return the most probable set of standstills, with its odds.

    largest_rate: largest rate of the record, rad/s. latest_start: largest index at which a segment may start
    and still count as the beginning of the record. other_biases: rad/s, of the other gyro axes. log_evidence:
    log likelihood of biases (M,) rad/s from gravity and Earth rate.
    """
    count = len(segments)
    none = np.zeros(count, bool)
    if not count:
        return StandstillChoice(none, 0.0, 0.0, none)
    log_turn = -np.log(2.0 * max(largest_rate, _MIN_TURN_RATE))
    drift_rate, drift_sigma = _drift_rate(segments)
    considered = np.argsort(segments.start - segments.end)[:_MAX_SEGMENTS]
    weights = _bias_weights(other_biases)
    normal = _normalisation(log_evidence, weights)
    hypotheses, scores, biases = [none], [_log_prior(0, len(considered))], [0.0]
    for candidate in _candidate_sets(segments, considered, drift_rate):
        members = np.flatnonzero(candidate)
        log_likelihood, bias = _log_marginal(segments, members, (drift_rate, drift_sigma), weights)
        if abs(bias) > MAX_BIAS:
            continue
        score = log_likelihood - _log_turns(log_likelihood, bias, len(members), log_turn, weights)
        score += _log_prior(len(members), len(considered))
        if segments.start[members[0]] <= latest_start:
            score += np.log(_START_ODDS)
        if log_evidence is not None:
            score += float(log_evidence(np.array([bias]))[0]) - normal
        hypotheses.append(candidate)
        scores.append(score)
        biases.append(bias)
    choice = _decide(hypotheses, np.array(scores), np.array(biases))
    counts = segments.end - segments.start
    longest = int(counts[choice.is_standstill].max(initial=0))
    longest_turn = int(counts[~choice.is_standstill].max(initial=0))
    is_slow = largest_rate < _MAX_SLOW_RATE and longest_turn > 0
    if is_slow or longest_turn > _MAX_TURN_LENGTH_RATIO * longest:
        return replace(choice, needed_odds=float("inf"))
    starts, ends = segments.start[choice.is_standstill], segments.end[choice.is_standstill]
    length = int((ends - starts).sum())
    is_sole = length > 0 and int(ends.max() - starts.min()) == length
    begins_record = is_sole and int(starts.min()) <= latest_start
    if is_sole and not (begins_record and length >= _MIN_SOLE_LENGTH_RATIO * longest_turn):
        evidence = 0.0 if log_evidence is None else float(log_evidence(np.array([choice.bias]))[0]) - normal
        if evidence < np.log(_CONFIRMING_RATIO):
            return replace(choice, needed_odds=float("inf"))
    return choice


def _decide(hypotheses: list[NDArray[np.bool_]], scores: Array, biases: Array) -> StandstillChoice:
    best = int(scores.argmax())
    if not best:
        alternative = int(scores[1:].argmax()) + 1 if len(scores) > 1 else 0
        return StandstillChoice(hypotheses[0], 0.0, 0.0, hypotheses[alternative])
    difference = np.abs(biases - biases[best])
    sets = np.array(hypotheses)
    common = (sets & sets[best]).sum(axis=1)
    nested = common == np.minimum(sets.sum(axis=1), sets[best].sum())
    same = difference < np.where(nested, _SAME_DRIFTING_BIAS, _SAME_BIAS)
    same[0] = False
    others = np.flatnonzero(~same)
    alternative = int(others[scores[others].argmax()])
    log_odds = float(logsumexp(scores[same]) - logsumexp(scores[~same]))
    return StandstillChoice(
        hypotheses[best], float(biases[best]), float(np.exp(min(log_odds, 50.0))), hypotheses[alternative]
    )


def _log_prior(standstills: int, count: int) -> float:
    """Return the log prior probability that exactly these of `count` segments are standstills."""
    return float(
        betaln(standstills + _STANDSTILL_COUNT, count - standstills + _TURN_COUNT)
        - betaln(_STANDSTILL_COUNT, _TURN_COUNT)
    )


def _drift_rate(segments: QuietSegments) -> tuple[float, float]:
    """Return the drift rate of the bias and its sigma, rad/s², from the slopes within the segments."""
    known = np.isfinite(segments.slope_sigma)
    if not known.any():
        return 0.0, float(_MAX_DRIFT_RATE / 2)
    weight = 1.0 / (segments.slope_sigma[known] ** 2 + _MIN_DRIFT_RATE**2)
    order = np.argsort(segments.slope[known])
    cumulative = np.cumsum(weight[order])
    middle = int(np.searchsorted(cumulative, 0.5 * cumulative[-1]))
    slope = float(np.clip(segments.slope[known][order][middle], -_MAX_DRIFT_RATE, _MAX_DRIFT_RATE))
    sigma = 1.25 / float(np.sqrt(weight.sum()))
    # A warm-up slows down, so the slope is valid only near the segments that show it.
    sigma = float(np.hypot(sigma, 0.3 * slope))
    return slope, float(np.clip(sigma, _MIN_DRIFT_RATE, _MAX_DRIFT_RATE / 2))


def _candidate_sets(
    segments: QuietSegments, considered: NDArray[np.int64], drift_rate: float
) -> list[NDArray[np.bool_]]:
    """Return sets of segments whose rates agree with one bias: about each segment, and each alone."""
    sets: dict[bytes, NDArray[np.bool_]] = {}
    drift_free = segments.rate - drift_rate * (segments.t - segments.t.mean())
    for k in considered:
        difference = np.abs(drift_free - drift_free[k])
        sigma = np.hypot(segments.sigma, segments.sigma[k])
        distance = np.abs(segments.t - segments.t[k])
        for limit in (
            3.0 * sigma + _RATE_JITTER,
            6.0 * np.sqrt(sigma**2 + _RATE_JITTER**2 + _RATE_WALK**2 * distance),
            6.0 * sigma + _RATE_JITTER + _MAX_DRIFT_RATE * distance,
        ):
            members = np.zeros(len(segments), bool)
            members[considered] = difference[considered] <= limit[considered]
            sets.setdefault(members.tobytes(), members)
        alone = np.arange(len(segments)) == k
        sets.setdefault(alone.tobytes(), alone)
    return list(sets.values())


def _log_marginal(
    segments: QuietSegments, members: NDArray[np.int64], drift: tuple[float, float], weights: Array
) -> tuple[float, float]:
    """Return the log likelihood of the rates of standstills with their bias integrated out, and the bias."""
    drift_rate, drift_sigma = drift
    t = segments.t[members] - segments.t[members].mean()
    y = segments.rate[members] - drift_rate * t
    from_first = segments.t[members] - segments.t[members].min()
    covariance = np.diag(segments.sigma[members] ** 2 + _RATE_JITTER**2)
    covariance = covariance + drift_sigma**2 * np.outer(t, t)
    covariance = covariance + _RATE_WALK**2 * np.minimum.outer(from_first, from_first)
    inverse = np.linalg.inv(covariance)
    ones = np.ones(len(y))
    bias = float(ones @ inverse @ y) / float(ones @ inverse @ ones)
    parts = []
    for sigma, weight in zip(_BIAS_SIGMAS, weights, strict=True):
        full = covariance + sigma**2
        _, logdet = np.linalg.slogdet(full)
        misfit = float(y @ np.linalg.solve(full, y))
        parts.append(np.log(weight) - 0.5 * (misfit + logdet + len(y) * np.log(2.0 * np.pi)))
    return float(logsumexp(parts)), bias


def _log_turns(log_likelihood: float, bias: float, count: int, log_turn: float, weights: Array) -> float:
    """Return the log likelihood of the rates if all segments are turns, at different rates or at one.

    log_likelihood: log likelihood of the rates as standstills.
    """
    log_bias = logsumexp(
        np.log(weights) - 0.5 * (bias / _BIAS_SIGMAS) ** 2 - np.log(_BIAS_SIGMAS * np.sqrt(2.0 * np.pi))
    )
    agreement = log_likelihood - float(log_bias)
    return float(max(count * log_turn, log_turn + (count - 1) * np.log(_SAME_TURN_RATE) + agreement))


def _bias_weights(other_biases: Array) -> Array:
    """Return the posterior weights of `_BIAS_SIGMAS`, given the biases of other axes, rad/s."""
    log = np.log(_BIAS_WEIGHTS)
    for bias in other_biases:
        log = log - 0.5 * (bias / _BIAS_SIGMAS) ** 2 - np.log(_BIAS_SIGMAS)
    weights = np.exp(log - log.max())
    return np.asarray(weights / weights.sum())


def _normalisation(log_evidence: Callable[[Array], Array] | None, weights: Array) -> float:
    """Return the log of the mean likelihood of gravity and Earth rate over the prior of the bias."""
    if log_evidence is None:
        return 0.0
    biases = np.linspace(-3.0, 3.0, 2401) * _BIAS_SIGMAS[-1]
    prior = sum(
        weight / sigma * np.exp(-0.5 * (biases / sigma) ** 2)
        for sigma, weight in zip(_BIAS_SIGMAS, weights, strict=True)
    )
    return float(logsumexp(log_evidence(biases), b=prior / np.sum(prior)))
