"""Selection among all names: probability of the true name and scope, in draws of the noise.

For small effects a drive is a linear model with Gaussian noise. The marginal likelihood of each name in each
scope is then known in closed form: its coordinates have a Gaussian prior whose width is uniform over decades.
All names have the same prior probability, shared equally by their scopes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp
from scipy.stats import ncx2, norm

from gap_matrix.world import Array

N_DRAWS = 200
# Prior widths in units of the typical size, equally probable. The narrowest is below all detectable sizes;
# otherwise, of two names that fit equally well, the one with the smaller typical size would win.
PRIOR_WIDTHS = np.geomspace(1e-4, 10.0, 11)
# Smallest eigenvalue of the information about the coordinates of a name that counts as observable.
_MIN_EIGENVALUE = 1e-3


@dataclass(frozen=True)
class NameOption:
    """A name in a scope, or one of several variants of it.

    basis: (D, k) directions of the k coordinates of the effect
    typical_sigma: (k,) prior 1 sigma of each coordinate, at a width of 1
    """

    name: str
    scope: str
    basis: Array
    typical_sigma: Array


class NameSelection:
    """Selection among all options of a drive by marginal likelihood, with fixed draws of the noise.

    gram: (D, D) information about the directions, nuisances marginalised
    """

    def __init__(self, gram: Array, options: Sequence[NameOption], rng: np.random.Generator) -> None:
        self._gram = gram
        values, vectors = np.linalg.eigh(gram)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        self.noise = rng.standard_normal((N_DRAWS, len(gram))) @ root.T
        self._keys = list(dict.fromkeys((option.name, option.scope) for option in options))
        n_forms = Counter(option.name for option in options)
        projections, occam_terms, log_priors, owners = [], [], [], []
        for option in options:
            for width in PRIOR_WIDTHS:
                scaled_basis = option.basis * (width * option.typical_sigma)
                eigenvalues, axes = np.linalg.eigh(scaled_basis.T @ gram @ scaled_basis)
                eigenvalues = np.maximum(eigenvalues, 0.0)
                projections.append(scaled_basis @ axes / np.sqrt(1.0 + eigenvalues))
                occam_terms.append(0.5 * float(np.sum(np.log1p(eigenvalues))))
                log_priors.append(-np.log(n_forms[option.name] * len(PRIOR_WIDTHS)))
                owners.append(self._keys.index((option.name, option.scope)))
        self._project = np.concatenate(projections, axis=1)
        self._starts = np.cumsum([0, *(projection.shape[1] for projection in projections[:-1])])
        self._offset = np.array(log_priors) - np.array(occam_terms)
        self._owner = np.array(owners)
        self._projected_noise = self.noise @ self._project

    def scores(self, direction: Array) -> Array:
        """Return the scores (N_DRAWS, D) for a true direction (D,), or (N_DRAWS, D) by draw."""
        return np.asarray(direction @ self._gram + self.noise)

    def select(self, direction: Array, factor: float, name: str, scope: str) -> tuple[Array, str]:
        """Return for each draw whether name and scope are selected, and the most frequent alternative.

        The truth is `factor` times the direction. A name is selected if it is more probable, over all its
        scopes, than all other names together; its most probable scope is selected.
        """
        projected = self._projected_noise + factor * (direction @ self._gram) @ self._project
        log_evidence = 0.5 * np.add.reduceat(projected**2, self._starts, axis=1) + self._offset
        probabilities = np.stack(
            [logsumexp(log_evidence[:, self._owner == k], axis=1) for k in range(len(self._keys))], axis=1
        )
        probabilities = np.exp(probabilities - logsumexp(probabilities, axis=1, keepdims=True))
        own_index = self._keys.index((name, scope))
        same_name = [k for k, key in enumerate(self._keys) if key[0] == name]
        is_name_selected = probabilities[:, same_name].sum(axis=1) > 0.5
        is_scope_selected = probabilities[:, own_index] >= probabilities[:, same_name].max(axis=1)
        others = probabilities.copy()
        others[:, own_index] = 0.0
        return is_name_selected & is_scope_selected, self._find_alternative(others, own_index)

    def _find_alternative(self, probabilities: Array, own_index: int) -> str:
        """Return the name, or scope of the true name, that is the best alternative in most draws."""
        most_frequent = Counter(np.argmax(probabilities, axis=1).tolist()).most_common(1)[0][0]
        name, scope = self._keys[most_frequent]
        return f"scope {scope}" if name == self._keys[own_index][0] else name


def is_detected(scores: Array, gram: Array, basis: Array, coordinates: Array, false_alarm: float) -> Array:
    """Return for each of R draws whether a test of one name alone detects it.

    scores: (R, D)
    coordinates: (k,) true coordinates

    The coordinates are fitted freely; the sign of a single coordinate is known.
    """
    eigenvalues, axes = np.linalg.eigh(basis.T @ gram @ basis)
    is_visible = eigenvalues > _MIN_EIGENVALUE
    direction = scores @ basis @ axes[:, is_visible] / np.sqrt(eigenvalues[is_visible])
    dof = int(np.count_nonzero(is_visible))
    if dof == 1:
        sign = np.sign(float((coordinates @ axes[:, is_visible])[0]))
        return np.asarray(sign * direction[:, 0] > norm.isf(false_alarm))
    return np.asarray(np.sum(direction**2, axis=1) > ncx2.isf(false_alarm, dof, 0.0))
