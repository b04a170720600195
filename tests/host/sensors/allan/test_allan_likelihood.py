"""The likelihood of octaves and slope is a density: it integrates to the same value for all terms."""

from dataclasses import replace

import numpy as np
import pytest

from hubodo.sensors.allan.covariance import covariance_tensor, design_matrix
from hubodo.sensors.allan.likelihood import ABSENT_LOG_SQUARE, Likelihood, N

RATE_HZ, SAMPLES = 10.0, 10_000


def test_the_variances_of_unit_terms_are_those_of_the_standard():
    """IEEE 952-1997, annex C, at half a second and two: 3 / tau², 1 / tau, 2 ln 2 / pi, tau / 3, tau² / 2."""
    flicker = 0.44127120
    expected = [[12.0, 2.0, flicker, 1 / 6, 0.125], [0.75, 0.5, flicker, 2 / 3, 2.0]]
    assert design_matrix(np.array([0.5, 2.0])) == pytest.approx(np.array(expected))


@pytest.mark.parametrize("factor", [1, 4, 64])
def test_the_density_of_an_octave_and_a_slope_integrates_to_the_same_for_any_noise(factor):
    """White noise of 1e-4 to 1e-1 over the slope and the cube root of the octave (nearly Gaussian)."""
    wholes = [integral(factor, density) for density in (1e-4, 3e-3, 1e-1)]
    assert wholes == pytest.approx([wholes[0]] * 3, rel=1e-6)


def integral(factor, density):
    place = np.array([factor])
    tau = place / RATE_HZ
    reported = Likelihood(
        place, tau, tau, covariance_tensor(place, SAMPLES, 1.0 / RATE_HZ), 0.0, SAMPLES / RATE_HZ, misfit=0.03
    )
    x = np.array([ABSENT_LOG_SQUARE] * 4 + [0.0, 0.0])
    x[N] = 2.0 * np.log(density)
    # Slope and octave are independent, so each is integrated by itself. Both ranges are wide enough for a few
    # percent of the octave and for the least-squares slope of white noise, N sqrt(12 / T³).
    roots = np.cbrt(density**2 / tau) * np.linspace(0.3, 1.7, 301)
    slopes = density * np.sqrt(12.0 / reported.duration**3) * np.linspace(-8.0, 8.0, 301)
    along = [replace(reported, avar=np.array([root**3])).cost(x) for root in roots]
    across = [replace(reported, avar=np.array([roots[150] ** 3]), slope=slope).cost(x) for slope in slopes]
    over_roots = np.trapezoid(np.exp(-0.5 * np.array(along)), roots)
    over_slopes = np.trapezoid(np.exp(-0.5 * np.array(across)), slopes)
    return over_roots * over_slopes * np.exp(0.5 * along[150])
