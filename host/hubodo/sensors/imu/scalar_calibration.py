"""Nine parameters of a triad from the length alone of a vector that is constant in space (Avrutov 2010).

In every pose the corrected measurement must be as long as gravity (or Earth rate, or a table's rate).
Avrutov's eq. 5 is linear because it drops products of errors and takes the direction cosines as known. Here
the directions come from the measurement itself and the equation is solved again about each solution, so
neither is needed:

    w = M^-1 (u - b),   (|w|² - 1) / 2 = 0 in every pose,   u in units of the reference

The length does not change when M is followed by a rotation; three of the six misalignments are therefore a
matter of convention: "symmetric" turns the three sensors least (d_xz = -d_yz and so on), "x-first" lets
sensor x define the x axis and sensor y the xy plane.

What a factory promises of scale and angles (`pose_set.Factory`) is one more measurement. Where the
poses say more it weighs nothing; where they say nothing, as six exact faces of the angles, it lets the rest
be found, with what an angle of that size would do to the rest in their sigmas.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.calibration.triad import Triad
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.imu.pose_set import (
    ACCELEROMETER,
    ANY_TRIAD,
    Factory,
    PoseSet,
    design,
    judge_poses,
    posterior,
)

Convention = Literal["symmetric", "x-first"]

MAX_ITERATIONS = 50
_SHOWN_BY = np.array([0, 1, 2, 3, 6, 7, 6, 4, 8, 7, 8, 5])
"""Which of the nine parameters shows each of b and of M row by row."""
_UNITS = {1 / 9.80665: "g", 1000 / 9.80665: "mg", 57.29578: "degrees per second", 57295.78: "mdps"}


@dataclass(frozen=True)
class ScalarCalibration:
    """What the lengths in R poses tell.

    triad: b in the unit of the measurement, and M. parameters: (9,) [b, e, differences] in the paper's order.
    covariance: (9, 9) of them. full_covariance: (12, 12) of b and M row by row, within the convention; of
    what the poses do not show it is what the factory promises. seen: (12,) which of b and M the poses show.
    residual: (R,) length after correction less reference, same unit. before: (R,) the same without
    correction. reduced_chi2: of the fit against the standard errors of the rests; above 1 the poses weigh
    less by it; None where nothing is left over to judge by.
    """

    triad: Triad
    parameters: Array
    covariance: Array
    full_covariance: Array
    seen: NDArray[np.bool_]
    reference: float
    residual: Array
    before: Array
    reduced_chi2: float | None
    poses: PoseSet
    convention: Convention
    iterations: int

    @property
    def sigma(self) -> Array:
        """(12,) 1 sigma of b and of M row by row."""
        return np.asarray(np.sqrt(np.diag(self.full_covariance)))


def scalar_calibration(
    measured: Array,
    reference: float,
    sigma: Array,
    *,
    convention: Convention = "symmetric",
    name: str = "accel",
    partial: bool = False,
) -> ScalarCalibration:
    """Solve for the nine parameters.

    measured: (R, 3) mean of each rest. reference: length of the true vector, same unit. sigma: (R, 3)
    standard errors of the means (not zero). partial: be content with what the poses show, of a MEMS
    accelerometer whose data sheet holds. Raises
    CalibrationError when the poses cannot show every parameter, or with `partial` not one (which, and which
    pose would help), when the unit is wrong by its magnitude, or when the fit does not settle.
    """
    if not reference > 0:
        raise InputError(f"the reference for the {name} triad must be positive, is {reference}")
    if convention not in ("symmetric", "x-first"):
        raise InputError(f"convention {convention!r} is unknown; choose symmetric or x-first")
    u, noise = measured / reference, sigma / reference
    length = np.linalg.norm(u, axis=1)
    _check_unit(float(np.median(length)), reference, name)
    factory = ACCELEROMETER if partial else ANY_TRIAD
    _check_poses(judge_poses(u / length[:, None], np.sqrt((noise**2).mean(axis=1)), factory), partial, name)
    fit = _Fit(u, noise, factory, name)
    p, iterations = fit.solve(np.zeros(9))
    w, rows, residual, variance = fit.linearise(p)
    # Only about the solution is a degenerate set sure to show: large errors hide it in the raw directions.
    poses = judge_poses(w / np.linalg.norm(w, axis=1)[:, None], np.sqrt(variance), factory)
    _check_poses(poses, partial, name)
    chi2 = fit.reduced_chi2(rows, residual, variance)
    covariance = fit.covariance(rows, variance, max(1.0, chi2 or 1.0)) + fit.of_second_order(p, ~poses.seen)

    def convert(p: Array) -> Array:
        m = _symmetric(p)
        return np.concatenate([p[:3] * reference, (_x_first(m) if convention == "x-first" else m).ravel()])

    full = convert(p)
    slope = _jacobian(convert, p)
    units = np.diag([reference] * 3 + [1.0] * 6)
    return ScalarCalibration(
        Triad(full[:3], full[3:].reshape(3, 3)),
        units @ p,
        units @ covariance @ units,
        slope @ covariance @ slope.T,
        poses.seen[_SHOWN_BY],
        reference,
        (np.linalg.norm(w, axis=1) - 1) * reference,
        (length - 1) * reference,
        chi2,
        poses,
        convention,
        iterations,
    )


@dataclass(frozen=True)
class _Fit:
    """Lengths of u (R, 3) with noise (R, 3), relative to the reference, and what the factory promises."""

    u: Array
    noise: Array
    factory: Factory
    name: str

    def solve(self, start: Array, held: int | None = None) -> tuple[Array, int]:
        """Gauss-Newton with step halving on the weighted lengths; (9,) parameters and how many steps.

        It moves only where the poses say more than the factory: along what they do not show, precise lengths
        would make a narrow bent ridge. held: a parameter that stays as it starts.
        """
        p, scale = start, self.factory.sigma.copy()
        if held is not None:
            scale[held] = 0.0
        directions = 9
        for iteration in range(1, MAX_ITERATIONS + 1):
            _, rows, residual, variance = self.linearise(p)
            weight = 1 / np.sqrt(variance)
            u, s, vt = np.linalg.svd(rows * weight[:, None] * scale, full_matrices=False)
            # Never more than before: about a better solution fewer may turn out to be seen.
            directions = min(directions, int(np.count_nonzero(s > 1.0)))
            seen = slice(0, directions)
            from_zero = vt @ (p / self.factory.sigma)
            gain = (s * (u.T @ (residual * weight)) - from_zero) / (s**2 + 1.0)
            step = scale * (vt[seen].T @ gain[seen])
            before = self._cost(p, weight)
            for _ in range(12):
                sound = np.linalg.eigvalsh(_symmetric(p + step))[0] > 0.1
                if sound and self._cost(p + step, weight) <= before * (1 + 1e-9) + 1e-20:
                    break
                step = step / 2
            p = p + step
            if np.abs(step).max() < 1e-13 + 1e-10 * np.abs(p).max():
                return p, iteration
        raise CalibrationError(
            f"the {self.name} calibration does not settle after {MAX_ITERATIONS} steps (last change "
            f"{np.abs(step).max():.1g} of the reference); check that the node was still in each rest and "
            "that the reference is right"
        )

    def _cost(self, p: Array, weight: Array) -> float:
        left = np.append(self.linearise(p)[2] * weight, p / self.factory.sigma)
        return float(left @ left)

    def linearise(self, p: Array) -> tuple[Array, Array, Array, Array]:
        """Corrected vectors, matrix (5) about them, right side less the noise's own square, its variance."""
        inverse = np.linalg.inv(_symmetric(p))
        w = (self.u - p[:3]) @ inverse.T
        v = w @ inverse
        own = (self.noise**2) @ (inverse**2).sum(axis=0)
        residual = ((w**2).sum(axis=1) - own - 1) / 2
        return w, design(v, w), residual, ((v * self.noise) ** 2).sum(axis=1)

    def covariance(self, rows: Array, variance: Array, widened: float = 1.0) -> Array:
        """(9, 9) of the parameters, the poses weighing less by `widened`."""
        return posterior(rows / np.sqrt(variance * widened)[:, None], self.factory)

    def reduced_chi2(self, rows: Array, residual: Array, variance: Array) -> float | None:
        """Of the lengths, by what the fit left free; None where that is nothing."""
        used = np.einsum("ri,ij,rj,r->", rows, self.covariance(rows, variance), rows, 1 / variance)
        freedom = len(residual) - float(used)
        return float((residual**2 / variance).sum()) / freedom if freedom > 0.5 else None

    def of_second_order(self, p: Array, unseen: NDArray[np.bool_]) -> Array:
        """(9, 9) of what unseen parameters do by their squares: an angle d shortens an axis by d²/2.

        For a parameter x of standard deviation s that acts as c x², the mean square is 3 c² s⁴.
        """
        made = np.zeros((9, 9))
        for k in np.flatnonzero(unseen):
            moved = []
            for sign in (-1, 1):
                start = p.copy()
                start[k] += sign * self.factory.sigma[k]
                moved.append(self.solve(start, held=int(k))[0] - p)
            even = (moved[0] + moved[1]) / 2
            made += 3 * np.outer(even, even)
        return made


def _symmetric(p: Array) -> Array:
    """M of the symmetric convention from [.., e, d_xz - d_yz, d_zy - d_xy, d_yx - d_zx]."""
    xy, xz, yz = p[6:9] / 2
    return np.array([[1 + p[3], xy, xz], [xy, 1 + p[4], yz], [xz, yz, 1 + p[5]]])


def _x_first(matrix: Array) -> Array:
    """The lower triangular matrix that measures the same lengths: M M' = L L'."""
    return np.asarray(np.linalg.cholesky(matrix @ matrix.T))


def _jacobian(function: Callable[[Array], Array], at: Array) -> Array:
    h = 1e-6
    return np.column_stack([(function(at + h * e) - function(at - h * e)) / (2 * h) for e in np.eye(len(at))])


def _check_poses(poses: PoseSet, partial: bool, name: str) -> None:
    if not (poses.seen.any() if partial else poses.sufficient):
        raise CalibrationError(poses.complaint(name))


def _check_unit(ratio: float, reference: float, name: str) -> None:
    if 0.5 < ratio < 2:
        return
    # Only the words depend on this guess.
    close = [unit for factor, unit in _UNITS.items() if 0.7 < ratio / factor < 1.4]
    guess = f", as if it were in {close[0]}" if close else ""
    raise CalibrationError(
        f"the {name} vector is {ratio * reference:.4g} long where {reference:.4g} is expected{guess}; "
        "convert the record to SI units (m/s², rad/s) or give the right reference"
    )
