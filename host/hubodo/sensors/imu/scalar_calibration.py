"""Nine parameters of a triad from the length alone of a vector that is constant in space (Avrutov 2010).

In every pose the corrected measurement must be as long as gravity (or Earth rate, or a table's rate).
Avrutov's eq. 5 is linear because it drops products of errors and takes the direction cosines as known. Here
the directions come from the measurement itself and the equation is solved again about each solution, so
neither is needed:

    w = M^-1 (u - b),   (|w|² - 1) / 2 = 0 in every pose,   u in units of the reference

The length does not change when M is followed by a rotation; three of the six misalignments are therefore a
matter of convention: "symmetric" turns the three sensors least (d_xz = -d_yz and so on), "x-first" lets
sensor x define the x axis and sensor y the xy plane.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hubodo.calibration.triad import Triad
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.imu.pose_set import PoseSet, design, judge_poses

Array = NDArray[np.float64]
Convention = Literal["symmetric", "x-first"]

MAX_ITERATIONS = 50
_UNITS = {1 / 9.80665: "g", 1000 / 9.80665: "mg", 57.29578: "degrees per second", 57295.78: "mdps"}


@dataclass(frozen=True)
class ScalarCalibration:
    """What the lengths in R poses tell.

    triad: b in the unit of the measurement, and M. parameters: (9,) [b, e, differences] in the paper's order.
    covariance: (9, 9) of them. full_covariance: (12, 12) of b and M row by row, within the convention.
    residual: (R,) length after correction less reference, same unit. before: (R,) the same without
    correction. reduced_chi2: of the fit against the standard errors of the rests; above 1 the covariance is
    widened by it; None with nine poses, when nothing is left over to judge by.
    """

    triad: Triad
    parameters: Array
    covariance: Array
    full_covariance: Array
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
) -> ScalarCalibration:
    """Solve for the nine parameters.

    measured: (R, 3) mean of each rest. reference: length of the true vector, same unit. sigma: (R, 3)
    standard errors of the means (not zero). Raises CalibrationError when the poses cannot show every
    parameter (which, and which pose would help), when the unit is wrong by its magnitude, or when the fit
    does not settle.
    """
    if not reference > 0:
        raise InputError(f"the reference for the {name} triad must be positive, is {reference}")
    if convention not in ("symmetric", "x-first"):
        raise InputError(f"convention {convention!r} is unknown; choose symmetric or x-first")
    u, noise = measured / reference, sigma / reference
    length = np.linalg.norm(u, axis=1)
    _check_unit(float(np.median(length)), reference, name)
    spread = np.sqrt((noise**2).mean(axis=1))
    first = judge_poses(u / length[:, None], spread)
    if not first.sufficient:
        raise CalibrationError(first.complaint(name))
    b, matrix, iterations = _solve(u, noise, name)
    w, rows, residual, variance = _linearise(u, noise, b, matrix)
    # Only about the solution is a degenerate set sure to show: large errors hide it in the raw directions.
    poses = judge_poses(w / np.linalg.norm(w, axis=1)[:, None], np.sqrt(variance))
    if not poses.sufficient:
        raise CalibrationError(poses.complaint(name))
    freedom = len(u) - 9
    chi2 = float((residual**2 / variance).sum()) / freedom if freedom else None
    covariance = np.linalg.inv((rows / variance[:, None]).T @ rows) * max(1.0, chi2 or 1.0)
    free = np.concatenate([b, np.diag(matrix) - 1, 2 * matrix[[0, 0, 1], [1, 2, 2]]])

    def convert(p: Array) -> Array:
        m = _symmetric(p)
        return np.concatenate([p[:3] * reference, (_x_first(m) if convention == "x-first" else m).ravel()])

    full = convert(free)
    slope = _jacobian(convert, free)
    units = np.diag([reference] * 3 + [1.0] * 6)
    return ScalarCalibration(
        Triad(full[:3], full[3:].reshape(3, 3)),
        units @ free,
        units @ covariance @ units,
        slope @ covariance @ slope.T,
        reference,
        (np.linalg.norm(w, axis=1) - 1) * reference,
        (length - 1) * reference,
        chi2,
        poses,
        convention,
        iterations,
    )


def _solve(u: Array, noise: Array, name: str) -> tuple[Array, Array, int]:
    """Gauss-Newton with step halving on the weighted lengths, from no error at all."""
    p = np.zeros(9)
    cost = np.inf
    for iteration in range(1, MAX_ITERATIONS + 1):
        _, rows, residual, variance = _linearise(u, noise, p[:3], _symmetric(p))
        weight = 1 / np.sqrt(variance)
        step = np.linalg.lstsq(rows * weight[:, None], residual * weight, rcond=None)[0]
        cost = float(((residual * weight) ** 2).sum())
        for _ in range(12):
            trial = p + step
            if np.linalg.eigvalsh(_symmetric(trial))[0] > 0.1:
                _, _, after, _ = _linearise(u, noise, trial[:3], _symmetric(trial))
                if float(((after * weight) ** 2).sum()) <= cost * (1 + 1e-9) + 1e-20:
                    break
            step = step / 2
        p = p + step
        if np.abs(step).max() < 1e-13 + 1e-10 * np.abs(p).max():
            return p[:3], _symmetric(p), iteration
    raise CalibrationError(
        f"the {name} calibration does not settle after {MAX_ITERATIONS} steps (last change "
        f"{np.abs(step).max():.1g} "
        "of the reference); check that the node was still in each rest and that the reference is right"
    )


def _linearise(u: Array, noise: Array, b: Array, matrix: Array) -> tuple[Array, Array, Array, Array]:
    """Corrected vectors, matrix (5) about them, right side less the noise's own square, and its variance."""
    inverse = np.linalg.inv(matrix)
    w = (u - b) @ inverse.T
    v = w @ inverse
    own = (noise**2) @ (inverse**2).sum(axis=0)
    residual = ((w**2).sum(axis=1) - own - 1) / 2
    return w, design(v, w), residual, ((v * noise) ** 2).sum(axis=1)


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
