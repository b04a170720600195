"""Prior of the coordinates of a fit, from the usual sizes of effects of sensors, mountings and vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.gap.linear.linearisation import invert_information
from hubodo.gap.state.terms import ModelTerm

# 1 sigma of the prior in usual sizes of a coordinate. It decides only where the log does not: a coordinate
# that the log determines to a tenth of its usual size moves by 0.1 % of its value.
_PRIOR_SCALES = 3.0
# Tempering above which residuals are so correlated that a small difference of a given effect looks like
# another effect; below it the difference itself is visible, and is one.
MIN_GIVEN_TEMPERING = 2.0
# Largest difference of a given effect from the model file that counts as repeatability, in its sigmas.
_MAX_DIFFERENCE_SIGMA = 2.0
# Information about a frozen coordinate, more than any log has.
_FROZEN_INFORMATION = 1e15


@dataclass(frozen=True)
class CoordinatePrior:
    """Gaussian prior of coordinates and nuisances, (K,), about the absent effect.

    information: (K,), diagonal of the inverse covariance, times the tempering
    value: (K,) current coordinates in scales
    tempering, given_tempering: factors by which correlated residuals exaggerate the information of the log
        about free terms and given effects; the prior is scaled alike
    """

    information: Array
    value: Array
    tempering: float
    given_tempering: float = 1.0

    @property
    def is_free(self) -> NDArray[np.bool_]:
        """Return False for each frozen coordinate, (K,)."""
        return self.information < _FROZEN_INFORMATION

    @property
    def gradient(self) -> Array:
        """Return half of the slope of the penalty at the current coordinates, (K,)."""
        return self.information * self.value

    def freeze(self, selected: NDArray[np.bool_]) -> CoordinatePrior:
        """Return a prior that freezes the selected coordinates, (K,), at their values."""
        information = np.where(selected, _FROZEN_INFORMATION, self.information)
        return replace(self, information=information, value=np.where(selected, 0.0, self.value))

    def penalty(self, step: Array) -> float:
        """Return the penalty after a step, in units of the deviance."""
        return float(self.information @ (self.value + step) ** 2)


def build_prior(
    terms: Sequence[ModelTerm], size: int, tempering: float, given_tempering: float | None = None
) -> CoordinatePrior:
    """Return the prior of the coordinates of terms, followed by free nuisances, `size` in total.

    Coordinates with several initial guesses, such as a time constant, and those of a limit have none. That of
    a nuisance is about its value in the model file.

    given_tempering: as in `CoordinatePrior`; None if it is equal to `tempering`
    """
    given_tempering = tempering if given_tempering is None else given_tempering
    information, value = np.zeros(size), np.zeros(size)
    first = 0
    for term in terms:
        scales = term.effect.coordinate_scales()
        inside = slice(first, first + len(scales))
        information[inside] = is_zero_in_guesses(type(term.effect)) * tempering / _PRIOR_SCALES**2
        value[inside] = term.effect.coordinates() / scales
        if term.is_nuisance:
            is_correlated = given_tempering > MIN_GIVEN_TEMPERING
            information[inside] = (
                given_tempering / term.repeatability**2 if is_correlated else _FROZEN_INFORMATION
            )
            value[inside] = 0.0
        frozen = [first + k for k in term.frozen]
        information[frozen], value[frozen] = _FROZEN_INFORMATION, 0.0
        first += len(scales)
    value[information == 0.0] = 0.0
    return CoordinatePrior(information, value, tempering, given_tempering)


def coordinate_slice(terms: Sequence[ModelTerm], term: ModelTerm) -> slice:
    """Return the positions of the coordinates of one of some terms. Raises KeyError for another term."""
    first = 0
    for other in terms:
        size = len(other.effect.coordinates())
        if other.key == term.key:
            return slice(first, first + size)
        first += size
    raise KeyError(term.key)


def adopt_prior(
    terms: Sequence[ModelTerm],
    size: int,
    tempering: float,
    other: CoordinatePrior,
    other_terms: Sequence[ModelTerm],
) -> CoordinatePrior:
    """Return the prior of terms that treats given effects as another prior does, and holds the same ones."""
    held = {
        term.key
        for term in other_terms
        if term.is_nuisance and not other.is_free[coordinate_slice(other_terms, term)].any()
    }
    is_held = np.zeros(size, bool)
    for term in terms:
        if term.is_nuisance and term.key in held:
            is_held[coordinate_slice(terms, term)] = True
    return build_prior(terms, size, tempering, other.given_tempering).freeze(is_held)


def determine_prior(
    terms: Sequence[ModelTerm], gram: Array, raw_squares: Array, tempering: float
) -> CoordinatePrior:
    """Return the prior of the coordinates of free terms and given effects, then attitudes.

    A given effect that would differ by more than its repeatability is held at its value: something else is
    missing.
    """
    prior = build_prior(terms, len(gram) - 1, tempering)
    given = [term for term in terms if term.is_nuisance]
    while given:
        covariance = invert_information(gram[:-1, :-1], raw_squares, prior.information)
        step = np.abs(covariance @ (gram[:-1, -1] - prior.gradient))
        excess = [step[coordinate_slice(terms, term)].max(initial=0.0) / term.repeatability for term in given]
        if max(excess) <= _MAX_DIFFERENCE_SIGMA:
            break
        held = given.pop(int(np.argmax(excess)))
        selected = np.zeros(len(step), bool)
        selected[coordinate_slice(terms, held)] = True
        prior = prior.freeze(selected)
    return prior


def is_zero_in_guesses(kind: type[Effect]) -> NDArray[np.bool_]:
    """Return True for each coordinate that is zero in all initial guesses of an effect, (k,)."""
    guesses = np.array([guess.coordinates() for guess in kind.initial_guesses()])
    return np.asarray(np.all(guesses == 0.0, axis=0))
