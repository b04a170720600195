"""Cost of selection: probability of the true name among all others, in draws of the noise.

Close to nothing a drive is a linear model with Gaussian noise. Of each name in each scope the marginal
likelihood is known in closed form then, its coordinates integrated over their prior: any direction, any size
within decades. All names are equally probable beforehand, the scopes of one share alike.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp
from scipy.stats import ncx2, norm

from gap_matrix.world import Array

DRAWS = 200
# Prior widths, times what is usual, each as likely as the others. The narrowest lies below all sizes that a
# drive shows: where the widths end, of two names that fit alike the one that is usually smaller would win.
WIDTHS = np.geomspace(1e-4, 10.0, 11)
# Eigenvalues of the information about a name's own coordinates from which on they are seen at all.
_VISIBLE = 1e-3


@dataclass(frozen=True)
class Option:
    """A name in a scope, or one of several forms of it.

    basis: (D, k) the directions that it moves. usual: (k,) prior 1 sigma along each, at width 1.
    """

    name: str
    scope: str
    basis: Array
    usual: Array


class Choice:
    """All options of a drive, with noise drawn for them once.

    gram: (D, D) information about the directions, everything that is always free taken out.
    """

    def __init__(self, gram: Array, options: Sequence[Option], rng: np.random.Generator) -> None:
        self._gram = gram
        values, vectors = np.linalg.eigh(gram)
        half = vectors * np.sqrt(np.maximum(values, 0.0))
        self.noise = rng.standard_normal((DRAWS, len(gram))) @ half.T
        self._keys = list(dict.fromkeys((it.name, it.scope) for it in options))
        forms = Counter(it.name for it in options)
        projections, occam, prior, owner = [], [], [], []
        for it in options:
            for width in WIDTHS:
                scaled = it.basis * (width * it.usual)
                spread, axes = np.linalg.eigh(scaled.T @ gram @ scaled)
                spread = np.maximum(spread, 0.0)
                projections.append(scaled @ axes / np.sqrt(1.0 + spread))
                occam.append(0.5 * float(np.sum(np.log1p(spread))))
                prior.append(-np.log(forms[it.name] * len(WIDTHS)))
                owner.append(self._keys.index((it.name, it.scope)))
        self._project = np.concatenate(projections, axis=1)
        self._starts = np.cumsum([0, *(one.shape[1] for one in projections[:-1])])
        self._offset = np.array(prior) - np.array(occam)
        self._owner = np.array(owner)
        self._drawn = self.noise @ self._project

    def scores(self, along: Array) -> Array:
        """(DRAWS, D), what is measured where the truth is `along`: (D,), or (DRAWS, D) of each draw."""
        return np.asarray(along @ self._gram + self.noise)

    def told(self, along: Array, factor: float, name: str, scope: str) -> tuple[Array, str]:
        """(DRAWS,) whether name and scope are chosen there, at `factor` times the truth; the nearest rival.

        Chosen: the name, in all of its scopes, is more probable than all others together, and of its scopes
        this one is the most probable.
        """
        made = self._drawn + factor * (along @ self._gram) @ self._project
        each = 0.5 * np.add.reduceat(made**2, self._starts, axis=1) + self._offset
        shares = np.stack(
            [logsumexp(each[:, self._owner == k], axis=1) for k in range(len(self._keys))], axis=1
        )
        shares = np.exp(shares - logsumexp(shares, axis=1, keepdims=True))
        own = self._keys.index((name, scope))
        family = [k for k, key in enumerate(self._keys) if key[0] == name]
        named = shares[:, family].sum(axis=1) > 0.5
        placed = shares[:, own] >= shares[:, family].max(axis=1)
        beside = shares.copy()
        beside[:, own] = 0.0
        return named & placed, self._rival(beside, own)

    def _rival(self, shares: Array, own: int) -> str:
        """The name, or the scope of the own name, that most often comes next."""
        first = Counter(np.argmax(shares, axis=1).tolist()).most_common(1)[0][0]
        name, scope = self._keys[first]
        return f"scope {scope}" if name == self._keys[own][0] else name


def seen(scores: Array, gram: Array, basis: Array, value: Array, alarm: float) -> Array:
    """Return whether a test of one name alone detects it, (R,); value: (k,) of its coordinates.

    Scores (R, D). Its coordinates are fitted freely; of a single one the sign is known.
    """
    spread, axes = np.linalg.eigh(basis.T @ gram @ basis)
    visible = spread > _VISIBLE
    along = scores @ basis @ axes[:, visible] / np.sqrt(spread[visible])
    freedom = int(np.count_nonzero(visible))
    if freedom == 1:
        sign = np.sign(float((value @ axes[:, visible])[0]))
        return np.asarray(sign * along[:, 0] > norm.isf(alarm))
    return np.asarray(np.sum(along**2, axis=1) > ncx2.isf(alarm, freedom, 0.0))
