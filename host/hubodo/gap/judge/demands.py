"""Demands on the gain of an effect: above chance, above the level of the noise, and on held-out samples."""

from __future__ import annotations

import math

from hubodo.effects.empirical import PREFIX
from hubodo.gap.refit.cross_validation import HeldOutGain
from hubodo.gap.refit.jackknife import JackknifeTest
from hubodo.gap.refit.linear_fit import Refit
from hubodo.gap.refit.prune import given_coordinates
from hubodo.gap.state.terms import ModelTerm

# Held-out gain, in sigma and as a share of the gain, that a hypothesis needs where residuals are correlated;
# in white noise the likelihood suffices.
MIN_HELD_OUT_Z, _MIN_HELD_OUT_SHARE = 2.5, 0.3
# Smallest held-out gain of a property of the vehicle, in sigma due to a noise level that varies along the
# road. There is no such limit for offsets and clocks, which differ from drive to drive. The larger value is
# for unnamed terms; the smaller one grows with the coordinates beyond those of a triad.
_MIN_LEVEL_SIGMAS, _MIN_LEVEL_SIGMAS_UNNAMED, _TRIAD_SIZE = 0.45, 1.3, 3
# Smallest gain of an effect that a varying noise level could produce where residuals are correlated, in ln
# likelihood, tempered: the mean of a real sensor's noise, which differs with the spin, imitates effects.
MIN_CORRELATED_GAIN, MIN_CORRELATED_TEMPERING = 45.0, 3.0
# The same under weights with the correlation of the noise, whatever the tempering. An effect also needs this
# -ln probability by the jackknife there, nominally that of the largest of 60 candidates in one of 200 logs,
# and this many sigma of its gain on held-out samples.
MIN_WHITENED_GAIN, _MIN_WHITENED_SURPRISE, MIN_WHITENED_Z = 30.0, 9.5, 8.0
# The same for the best determined coordinate, in sigma of the jackknife.
_MIN_WHITENED_AGREEMENT = 5.0
# -ln probability, by the jackknife, up to which that gain is demanded in full, and from which on it is not:
# in the noise of real drives without an effect, the most surprising of 60 candidates has a median of 3 nats,
# and 7 at most.
_CHANCE_SURPRISE, _CERTAIN_SURPRISE = 7.0, 11.0
# Surprise from which on the estimates of an effect from parts of the log agree: one null drive in 60 has it.
CONSISTENT_SURPRISE = 8.0


def is_within_level(term: ModelTerm, gain: HeldOutGain) -> bool:
    """Return True if a varying noise level could produce the held-out gain of a term."""
    return gain.total < doubtful_gain(term, gain)


def doubtful_gain(term: ModelTerm, gain: HeldOutGain) -> float:
    """Return the held-out gain of a term that a varying noise level could produce."""
    is_unnamed = term.effect.name.startswith(PREFIX)
    size_ratio = max(len(term.effect.coordinates()) / _TRIAD_SIZE, 1.0)
    sigmas = _MIN_LEVEL_SIGMAS_UNNAMED if is_unnamed else _MIN_LEVEL_SIGMAS * math.sqrt(size_ratio)
    return min(sigmas * gain.level_sigma, gain.max_doubt)


def helps_held_out(gain: float, held_out_gain: HeldOutGain, tempering: float = math.inf) -> bool:
    """Return True if a term gains more on held-out samples than correlated residuals do by chance.

    tempering: infinite for residuals that are as correlated as can be
    """
    correlated_share = 1.0 - 1.0 / tempering
    return (
        held_out_gain.z >= MIN_HELD_OUT_Z * correlated_share
        and held_out_gain.total >= _MIN_HELD_OUT_SHARE * correlated_share * gain
    )


def apply_jackknife(fit: Refit, key: tuple[str, str]) -> JackknifeTest:
    """Test an estimate by the jackknife against its value in the model file, or against its absence."""
    term = next(term for term in fit.free_terms if term.key == key)
    return fit.apply_jackknife(term, given_coordinates(fit, term))


def chance_gain(tempering: float, surprise: float = 0.0) -> float:
    """Return the gain on held-out samples that correlated residuals produce by chance under white weights.

    surprise: -ln of the probability of the estimate without the effect, by the jackknife
    """
    if tempering <= MIN_CORRELATED_TEMPERING:
        return 0.0
    share = (_CERTAIN_SURPRISE - surprise) / (_CERTAIN_SURPRISE - _CHANCE_SURPRISE)
    return MIN_CORRELATED_GAIN * tempering * min(max(share, 0.0), 1.0)


def is_steady_when_whitened(jackknife: JackknifeTest, held_out_gain: HeldOutGain) -> bool:
    """Return True if parts of the log agree as weights with the correlation of the noise demand it.

    All coordinates together may differ from zero in a way that none of them confirms.
    """
    return (
        jackknife.surprise >= _MIN_WHITENED_SURPRISE
        and jackknife.agreement_sigmas >= _MIN_WHITENED_AGREEMENT
        and held_out_gain.z >= MIN_WHITENED_Z
    )
