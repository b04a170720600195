"""Scalar calibration of a sensor triad from the known norm of a constant vector (Avrutov 2010).

In every pose the norm of the corrected measurement must equal that of gravity (or Earth rate, or a table's
rate). Avrutov's eq. 5 is linear, because it neglects products of errors and assumes known direction
cosines. Here the directions come from the measurement, and the equation is relinearised about each
solution, so neither is needed:

    w = M^-1 (u - b),   (|w|² - 1) / 2 = 0 in every pose

u is the measurement in units of the reference, b the bias, M the matrix of scale factors and
misalignments. The norm does not change when M is followed by a rotation, so three of the six misalignments
are a matter of convention: "symmetric" rotates the three sensors least (d_xz = -d_yz and so on); with
"x-first", sensor x defines the x axis and sensor y the xy plane.

The factory tolerances of scale and angles (`pose_observability.FactoryTolerance`) enter as a prior. Where
the poses are informative, the prior has no weight. Where they are not (six exact faces do not show the
angles), it allows the other parameters to be estimated, and their sigmas include the effect of an angle of
that size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from hubodo.arrays import Array
from hubodo.calibration.triad import Triad
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.imu.pose_observability import (
    ACCELEROMETER_TOLERANCE,
    WIDE_TOLERANCE,
    FactoryTolerance,
    PoseObservability,
    assess_poses,
    pose_design_matrix,
    posterior_covariance,
)

Convention = Literal["symmetric", "x-first"]

_MAX_CHANCE = 0.01
"""Probability of a reduced chi-square below which the noise level is taken from the misfit."""
MAX_ITERATIONS = 50
_NONLINEAR_ITERATIONS = 4
"""Iterations that invert terms of up to 3 % of the reference to 1e-6."""
_DETERMINING_PARAMETER = np.array([0, 1, 2, 3, 6, 7, 6, 4, 8, 7, 8, 5])
"""Index of the parameter that determines each element of b, and of M row by row."""
_UNIT_OF_RATIO = {1 / 9.80665: "g", 1000 / 9.80665: "mg", 57.29578: "degrees per second", 57295.78: "mdps"}


@dataclass(frozen=True)
class PoseTerm:
    """A term k w y^n of the reading, with the linear reading y and a known weight w of each pose.

    Attributes:
        exponent: n; 0 for a bias that follows the weight, 1 for a scale.
        weight: (R,) such as a power of the temperature.
    """

    exponent: int
    weight: Array


@dataclass(frozen=True)
class ScalarCalibration:
    """The scalar calibration of a triad from R poses.

    Attributes:
        triad: bias b in the unit of the measurement, and matrix M.
        parameters: (9,) [b, scale errors, differences of two angles] in the order of the paper.
        covariance: (9, 9) of the parameters.
        full_covariance: (12, 12) of b and of M row by row, within the convention; for unobservable
            elements it is that of the factory tolerances.
        is_observable: (12,) True for the elements of b and M that the poses determine.
        reference: norm of the true vector.
        residual, residual_before: (R,) norm minus reference with and without correction.
        reduced_chi2: reduced chi-square of the fit, relative to the standard errors of the standstills; the
            covariance is scaled by it if it exceeds 1. None without degrees of freedom.
        poses: observability of the parameters.
        convention: convention of the misalignments, see the module.
        iterations: Gauss-Newton steps.
        exponents: n of each nonlinear term k_i y_i^n of the linear reading y, estimated beside the nine
            parameters.
        nonlinear: (3 len(exponents),) k by exponent, then axis, in units of the reference.
        nonlinear_sigma: 1 sigma of each k.
        pose_terms, pose_term_sigma: (T, 3) coefficients of the pose terms and their 1 sigma, in units of the
            reference; see `PoseTerm`.
    """

    triad: Triad
    parameters: Array
    covariance: Array
    full_covariance: Array
    is_observable: NDArray[np.bool_]
    reference: float
    residual: Array
    residual_before: Array
    reduced_chi2: float | None
    poses: PoseObservability
    convention: Convention
    iterations: int
    exponents: tuple[int, ...] = ()
    nonlinear: Array = field(default_factory=lambda: np.zeros(0))
    nonlinear_sigma: Array = field(default_factory=lambda: np.zeros(0))
    pose_terms: Array = field(default_factory=lambda: np.zeros((0, 3)))
    pose_term_sigma: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def correct(self, raw: Array) -> Array:
        """Return true values from raw ones, (N, 3), less nonlinear terms; pose terms stay."""
        u = raw / self.reference
        linear = _remove_nonlinearity(u, self.exponents, self.nonlinear)
        return self.triad.correct(raw, self.reference * (u - linear))

    @property
    def sigma(self) -> Array:
        """Return the (12,) sigmas of b and of M row by row."""
        return np.asarray(np.sqrt(np.diag(self.full_covariance)))


def fit_scalar_calibration(
    measured: Array,
    reference: float,
    sigma: Array,
    *,
    convention: Convention = "symmetric",
    name: str = "accel",
    allow_partial: bool = False,
    exponents: tuple[int, ...] = (),
    pose_terms: tuple[PoseTerm, ...] = (),
) -> ScalarCalibration:
    """Estimate the nine parameters of a triad.

    measured: (R, 3) mean of each standstill. reference: norm of the true vector, same unit. sigma: (R, 3)
    standard errors of the means, not zero. allow_partial: accept poses that determine only some parameters,
    using the tolerances of MEMS accelerometers. exponents: of nonlinear terms, see `ScalarCalibration`.
    pose_terms: further terms, estimated beside the others. Raises CalibrationError if the poses do not
    determine every parameter (with `allow_partial`: any), for a wrong unit, or if the fit does not converge.
    """
    _check_choices(reference, convention, name)
    u, noise = measured / reference, sigma / reference
    length = np.linalg.norm(u, axis=1)
    _check_unit(float(np.median(length)), reference, name)
    factory = ACCELEROMETER_TOLERANCE if allow_partial else WIDE_TOLERANCE
    _check_poses(
        assess_poses(u / length[:, None], np.sqrt((noise**2).mean(axis=1)), factory), allow_partial, name
    )
    terms = (*(PoseTerm(n, np.ones(len(u))) for n in exponents), *pose_terms)
    fit, p, iterations = _NormFit(u, noise, factory, name, terms, u).solve_with_terms()
    w, rows, residual, variance = fit.linearise(p)
    # Large errors distort the raw directions and can hide a degenerate set of poses, so it is checked
    # again here.
    poses = assess_poses(w / np.linalg.norm(w, axis=1)[:, None], np.sqrt(variance), factory)
    _check_poses(poses, allow_partial, name)
    chi2 = fit.reduced_chi2(rows, residual, variance)
    variance_factor = fit.variance_factor(chi2)
    covariance = fit.covariance(rows, variance, variance_factor) + fit.of_second_order(
        p, ~poses.is_observable
    )

    def convert(p: Array) -> Array:
        m = _symmetric(p)
        return np.concatenate([p[:3] * reference, (_x_first(m) if convention == "x-first" else m).ravel()])

    full = convert(p)
    jacobian = _jacobian(convert, p)
    units = np.diag([reference] * 3 + [1.0] * 6)
    nonlinear, nonlinear_sigma, remainder = fit.nonlinear(p, variance_factor)
    return ScalarCalibration(
        Triad(full[:3], full[3:].reshape(3, 3)),
        units @ p,
        units @ covariance @ units,
        jacobian @ covariance @ jacobian.T,
        poses.is_observable[_DETERMINING_PARAMETER],
        reference,
        (np.linalg.norm(w, axis=1) - 1 - remainder) * reference,
        (length - 1) * reference,
        chi2,
        poses,
        convention,
        iterations,
        exponents,
        nonlinear[: 3 * len(exponents)],
        nonlinear_sigma[: 3 * len(exponents)],
        nonlinear[3 * len(exponents) :].reshape(-1, 3),
        nonlinear_sigma[3 * len(exponents) :].reshape(-1, 3),
    )


@dataclass(frozen=True)
class _NormFit:
    """Least-squares fit to the norms of u (R, 3) with noise (R, 3), relative to the reference, with prior.

    The `terms`, weighted powers of the `linear` reading (R, 3), have no prior. They are eliminated from
    residuals and design matrix (variable projection).
    """

    u: Array
    noise: Array
    factory: FactoryTolerance
    name: str
    terms: tuple[PoseTerm, ...]
    linear: Array

    def solve_with_terms(self) -> tuple[_NormFit, Array, int]:
        """Return the fit with its linear readings, the (9,) parameters and the number of steps."""
        p, iterations = self.solve(np.zeros(9))
        if not self.terms:
            return self, p, iterations
        fit = replace(self, linear=_remove_terms(self.u, self.terms, self.nonlinear(p, 1.0)[0]))
        return (fit, *fit.solve(p))

    def solve(self, start: Array, fixed: int | None = None) -> tuple[Array, int]:
        """Minimise by Gauss-Newton with step halving; return the (9,) parameters and the number of steps.

        Steps are restricted to directions in which the poses are more informative than the prior: along
        the others precise norms form a narrow curved valley. fixed: index of a parameter that is not
        changed.
        """
        p, scale = start, self.factory.sigma.copy()
        if fixed is not None:
            scale[fixed] = 0.0
        direction_count = 9
        for iteration in range(1, MAX_ITERATIONS + 1):
            _, rows, residual, variance = self.linearise(p)
            weight = 1 / np.sqrt(variance)
            u, s, vt = np.linalg.svd(rows * weight[:, None] * scale, full_matrices=False)
            # The number of observable directions may only decrease, which guarantees convergence.
            direction_count = min(direction_count, int(np.count_nonzero(s > 1.0)))
            observable = slice(0, direction_count)
            from_zero = vt @ (p / self.factory.sigma)
            gain = (s * (u.T @ (residual * weight)) - from_zero) / (s**2 + 1.0)
            step = scale * (vt[observable].T @ gain[observable])
            cost = self._cost(p, weight)
            for _ in range(12):
                is_valid = np.linalg.eigvalsh(_symmetric(p + step))[0] > 0.1
                if is_valid and self._cost(p + step, weight) <= cost * (1 + 1e-9) + 1e-20:
                    break
                step = step / 2
            p = p + step
            # Variable projection neglects the derivative of the eliminated terms and converges linearly.
            tolerance = 1e-9 if self.terms else 1e-13 + 1e-10 * np.abs(p).max()
            if np.abs(step).max() < tolerance:
                return p, iteration
        raise CalibrationError(
            f"the {self.name} calibration does not converge in {MAX_ITERATIONS} steps (last change "
            f"{np.abs(step).max():.1g} of the reference); check that the node was stationary in each "
            "standstill and that the reference is correct"
        )

    def _cost(self, p: Array, weight: Array) -> float:
        weighted_residuals = np.append(self.linearise(p)[2] * weight, p / self.factory.sigma)
        return float(weighted_residuals @ weighted_residuals)

    def linearise(self, p: Array) -> tuple[Array, Array, Array, Array]:
        """Return corrected vectors, design matrix (eq. 5), residuals without noise power, variances."""
        inverse = np.linalg.inv(_symmetric(p))
        w = (self.u - p[:3]) @ inverse.T
        v = w @ inverse
        noise_power = (self.noise**2) @ (inverse**2).sum(axis=0)
        residual = ((w**2).sum(axis=1) - noise_power - 1) / 2
        rows, variance = pose_design_matrix(v, w), ((v * self.noise) ** 2).sum(axis=1)
        if self.terms:
            weight = np.sqrt(variance)[:, None]
            basis = np.linalg.qr(self._nonlinear_columns(v) / weight)[0]
            both = np.column_stack([rows, residual]) / weight
            both = (both - basis @ (basis.T @ both)) * weight
            rows, residual = both[:, :9], both[:, 9]
        return w, rows, residual, variance

    def _nonlinear_columns(self, v: Array) -> Array:
        """Return the (R, 3 len(terms)) derivatives of |w|²/2 by the nonlinear terms, but for the sign."""
        return np.hstack([v * self.linear**term.exponent * term.weight[:, None] for term in self.terms])

    def nonlinear(self, p: Array, variance_factor: float) -> tuple[Array, Array, Array]:
        """Return the nonlinear terms k, their sigmas, and their part of each residual (R,).

        Their covariance follows from the joint information matrix with the nine parameters `p`.
        """
        linear = replace(self, terms=())
        w, rows, residual, variance = linear.linearise(p)
        if not self.terms:
            return np.zeros(0), np.zeros(0), np.zeros(len(residual))
        weight = np.sqrt(variance)
        columns = self._nonlinear_columns(w @ np.linalg.inv(_symmetric(p)))
        k = np.linalg.lstsq(columns / weight[:, None], residual / weight, rcond=None)[0]
        joint = np.column_stack([columns, rows]) / (weight * np.sqrt(variance_factor))[:, None]
        prior = np.append(np.zeros(len(k)), self.factory.sigma**-2)
        covariance = np.linalg.inv(joint.T @ joint + np.diag(prior))
        return np.asarray(k), np.asarray(np.sqrt(np.diag(covariance)[: len(k)])), np.asarray(columns @ k)

    def covariance(self, rows: Array, variance: Array, variance_factor: float = 1.0) -> Array:
        """Return the (9, 9) covariance of the parameters, with the variances of the poses times `widened`."""
        return posterior_covariance(rows / np.sqrt(variance * variance_factor)[:, None], self.factory)

    def reduced_chi2(self, rows: Array, residual: Array, variance: Array) -> float | None:
        """Return the reduced chi-square of the norms, or None without degrees of freedom."""
        used = np.einsum("ri,ij,rj,r->", rows, self.covariance(rows, variance), rows, 1 / variance)
        freedom = len(residual) - float(used) - 3 * len(self.terms)
        return float((residual**2 / variance).sum()) / freedom if freedom > 0.5 else None

    def variance_factor(self, chi2: float | None) -> float:
        """Return the factor by which a reduced chi-square widens the variances.

        If chance does not explain it, the noise level is an estimate from few poses, and the variance is that
        of Student's t distribution.
        """
        dof = len(self.u) - 9 - 3 * len(self.terms)
        if chi2 is None or dof <= 2 or chdtrc(dof, chi2 * dof) > _MAX_CHANCE:
            return max(1.0, chi2 or 1.0)
        return chi2 * dof / (dof - 2)

    def of_second_order(self, p: Array, unobservable: NDArray[np.bool_]) -> Array:
        """Return the (9, 9) second-order effect of unobservable parameters (angle d: axis shorter by d²/2).

        For a parameter x with standard deviation s and the effect c x², the mean square is 3 c² s⁴.
        """
        covariance = np.zeros((9, 9))
        for k in np.flatnonzero(unobservable):
            changes = []
            for sign in (-1, 1):
                start = p.copy()
                start[k] += sign * self.factory.sigma[k]
                changes.append(self.solve(start, fixed=int(k))[0] - p)
            even_part = (changes[0] + changes[1]) / 2
            covariance += 3 * np.outer(even_part, even_part)
        return covariance


def _remove_nonlinearity(u: Array, exponents: tuple[int, ...], k: Array) -> Array:
    """Return y (N, 3) of u = y + sum of k_n y^n. u: relative to the reference. k: by exponent, then axis."""
    return _remove_terms(u, tuple(PoseTerm(n, np.ones(len(u))) for n in exponents), k)


def _remove_terms(u: Array, terms: tuple[PoseTerm, ...], k: Array) -> Array:
    """Return y (N, 3) of u = y + sum of k_n w_n y^n. u: relative to the reference. k: by term, then axis."""
    y = u
    for _ in range(_NONLINEAR_ITERATIONS if terms else 0):
        pairs = zip(terms, k.reshape(-1, 3), strict=True)
        y = u - sum(row * term.weight[:, None] * y**term.exponent for term, row in pairs)
    return y


def _symmetric(p: Array) -> Array:
    """Return M of the symmetric convention from b, e and [d_xz - d_yz, d_zy - d_xy, d_yx - d_zx]."""
    xy, xz, yz = p[6:9] / 2
    return np.array([[1 + p[3], xy, xz], [xy, 1 + p[4], yz], [xz, yz, 1 + p[5]]])


def _x_first(matrix: Array) -> Array:
    """Return the lower triangular matrix L with the same norms: M M' = L L'."""
    return np.asarray(np.linalg.cholesky(matrix @ matrix.T))


def _jacobian(function: Callable[[Array], Array], point: Array) -> Array:
    h = 1e-6
    return np.column_stack(
        [(function(point + h * e) - function(point - h * e)) / (2 * h) for e in np.eye(len(point))]
    )


def _check_choices(reference: float, convention: str, name: str) -> None:
    if not reference > 0:
        raise InputError(f"the reference for the {name} triad must be positive, is {reference}")
    if convention not in ("symmetric", "x-first"):
        raise InputError(f"convention {convention!r} is unknown; choose symmetric or x-first")


def _check_poses(poses: PoseObservability, partial: bool, name: str) -> None:
    if not (poses.is_observable.any() if partial else poses.is_sufficient):
        raise CalibrationError(poses.describe_deficit(name))


def _check_unit(ratio: float, reference: float, name: str) -> None:
    if 0.5 < ratio < 2:
        return
    # This estimate only affects the text of the error.
    matching = [unit for factor, unit in _UNIT_OF_RATIO.items() if 0.7 < ratio / factor < 1.4]
    guess = f", as if it were in {matching[0]}" if matching else ""
    raise CalibrationError(
        f"the {name} vector has the norm {ratio * reference:.4g} where {reference:.4g} is expected{guess}; "
        "convert the record to SI units (m/s², rad/s) or give the correct reference"
    )
