"""Test of the measured Earth rate against the value that the latitude implies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from hubodo.arrays import Array
from hubodo.earth import EARTH_RATE
from hubodo.sensors.north.circular import single_measured_direction
from hubodo.sensors.north.likelihood import EarthRatePosterior

MAX_DOUBT = 1e-3
"""Probability below which the measured rate contradicts the demanded one."""
_SCALE_SIGMA = 0.02
"""Relative 1σ of the measured rate from the gyro's scale factor, 1 %, and from half a degree of tilt."""
_SINGLE_DOF_RATIO = 3.0
"""Earth rate over its sigma from which its size has one degree of freedom; below, its direction adds one."""
_RIGHT_RATIO = 0.15
"""Relative deviation up to which another latitude explains the measured rate."""


@dataclass(frozen=True)
class EarthRateTest:
    """The horizontal Earth rate as measured and as implied by the latitude.

    Attributes:
        measured, sigma: rad/s, along the axis, without the constraint by latitude.
        demanded: rate that the latitude implies, rad/s.
        chi_square, probability: statistic of the deviation, and probability of one at least as large by
            chance.
        depends_on_latitude: True if the azimuth follows from the implied rate, as with stops along one line.
    """

    measured: float
    sigma: float
    demanded: float
    chi_square: float
    probability: float
    depends_on_latitude: bool

    @property
    def is_contradicted(self) -> bool:
        """Return True if the measured rate contradicts the rate that the latitude implies."""
        return self.probability < MAX_DOUBT

    @property
    def excess_sigma(self) -> float:
        """Return the azimuth sigma, rad, due to a disturbance as large as the deviation, or 0."""
        return abs(self.measured - self.demanded) / self.demanded if self.is_contradicted else 0.0

    @property
    def is_earth_rate(self) -> bool:
        """Return False if the measured rate contradicts the latitude by a factor of three or more."""
        return not self.is_contradicted or 1 / 3 < self.measured / self.demanded < 3


def check_earth_rate(posterior: EarthRatePosterior, horizontal: float) -> EarthRateTest:
    """Test the measured rate against `horizontal`, rad/s, the rate that the latitude implies.

    Stops along one line measure only one component, which contradicts the latitude if it exceeds that rate.
    """
    rate, covariance = posterior.rate, posterior.rate_covariance
    line = single_measured_direction(posterior)
    if line is not None:
        along = np.array([np.cos(line), np.sin(line)])
        measured = abs(float(along @ rate))
        sigma = float(np.hypot(np.sqrt(along @ covariance @ along), _SCALE_SIGMA * horizontal))
        chi_square = (max(0.0, measured - horizontal) / sigma) ** 2
        return EarthRateTest(
            measured, sigma, horizontal, chi_square, float(chdtrc(1, chi_square)), depends_on_latitude=True
        )
    size = float(np.linalg.norm(rate))
    along = rate / max(size, 1e-300)
    variance = float(along @ covariance @ along)
    sigma = float(np.hypot(np.sqrt(variance), _SCALE_SIGMA * horizontal))
    chi_square = _least_misfit(rate, covariance, horizontal)
    dof = 1 if horizontal > _SINGLE_DOF_RATIO * sigma else 2
    return EarthRateTest(
        size, sigma, horizontal, chi_square, float(chdtrc(dof, chi_square)), depends_on_latitude=False
    )


def describe_earth_rate(test: EarthRateTest, latitude: float, level: float) -> str:
    """Return measured rate, rate implied by the latitude (rad), and likely cause of the difference as text.

    level: fraction of the horizontal Earth rate that the axis measures.
    """
    deg_h = np.degrees(1.0) * 3600
    text = (
        f"{test.measured * deg_h:.1f} ± {test.sigma * deg_h:.1f} °/h of horizontal Earth rate were measured, "
        f"{test.demanded * deg_h:.1f} °/h belong to latitude {np.degrees(latitude):.6g} "
        f"(chi-square {test.chi_square:.1f}, probability {test.probability:.1g})"
    )
    return f"{text}: {_guess_cause(test, latitude, level)}"


def _guess_cause(test: EarthRateTest, latitude: float, level: float) -> str:
    ratio = test.measured / test.demanded
    for factor, unit in ((np.degrees(1.0), "deg/s"), (1 / np.degrees(1.0), "rad/s")):
        if abs(ratio / factor - 1) < _RIGHT_RATIO:
            other = "rad/s" if unit == "deg/s" else "deg/s"
            return f"the gyro looks like {unit} read as {other}; give --unit {unit}"
    degrees = float(np.degrees(latitude))
    guesses = []
    for value, what in (
        (float(np.degrees(degrees)), "--latitude-deg looks like radians"),
        (90.0 - abs(degrees), "--latitude-deg looks like the angle from the pole"),
    ):
        demanded = EARTH_RATE * float(np.cos(np.radians(value))) * level
        if abs(value) < 90 and abs(test.measured - demanded) < max(
            2 * test.sigma, _RIGHT_RATIO * test.measured
        ):
            guesses.append(f"{what} ({value:.1f} degrees would fit)")
    full = test.measured / (EARTH_RATE * level)
    if not guesses and full <= 1 + 2 * test.sigma / EARTH_RATE:
        fitting = float(np.degrees(np.arccos(min(1.0, full))))
        guesses.append(f"a latitude of {fitting:.0f} degrees north or south would fit")
    guesses.append("or the gyro's scale, its sensitivity to tilt, or a table that is not level")
    return f"{', '.join(guesses)}; check --latitude-deg"


def _least_misfit(rate: Array, covariance: Array, horizontal: float) -> float:
    """Return the smallest chi-square of the measured vector over all azimuths of a vector of known size."""
    azimuth = np.radians(np.arange(0.0, 360.0, 0.1))
    direction = np.stack([np.cos(azimuth), np.sin(azimuth)])
    deviation = rate[:, None] - horizontal * direction
    scale_variance = (_SCALE_SIGMA * horizontal) ** 2
    information = np.linalg.inv(covariance + scale_variance * np.eye(2))
    return float(np.einsum("ik,ij,jk->k", deviation, information, deviation).min())
