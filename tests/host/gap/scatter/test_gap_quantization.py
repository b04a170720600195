"""Detection of quantization, against explicit log densities."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from gap_residuals import SEEDS, SIGMA, build_residual, draw_readings
from hubodo.gap.scatter.quantization import detect_quantization, find_lattice_step


@pytest.mark.parametrize("seed", SEEDS)
def test_the_gain_of_quantization_is_the_log_density_ratio_with_rounding_variance(seed):
    """Outliers beyond 4 sigma are excluded; the outlier detector handles them."""
    step = 0.04
    clean, y = draw_readings(np.random.default_rng(seed))
    y[:3] = step * np.round(y[:3] / step)
    y[0, ::100] += 10.0 * step
    residual = build_residual(y, clean)
    assert find_lattice_step(residual) == pytest.approx(step, rel=1e-5)
    proposals = detect_quantization([residual])
    assert [it.term.effect.name for it in proposals] == ["gyro_quantization"]
    wide_sigma = np.sqrt(SIGMA[:3] ** 2 + step**2 / 12.0)
    values = residual.value[:3]
    is_inlier = np.abs(values) < 4.0 * wide_sigma
    gains = norm.logpdf(values, scale=wide_sigma) - norm.logpdf(values, scale=SIGMA[:3])
    assert proposals[0].gain == pytest.approx(float(gains[is_inlier].sum()), rel=1e-9)


def test_the_gain_of_quantization_is_capped_at_one_and_a_half_times_its_divergence():
    """The cap applies if the noise has other causes; the Kullback-Leibler divergence is a quadrature."""
    step = 0.04
    rng = np.random.default_rng(1)
    clean, y = draw_readings(rng)
    y[:3] = step * np.round((y[:3] + 0.03 * rng.standard_normal(y[:3].shape)) / step)
    narrow_density = norm(scale=SIGMA[0, 0])
    wide_density = norm(scale=np.hypot(SIGMA[0, 0], step / np.sqrt(12.0)))
    divergence_per_sample, _ = quad(
        lambda x: wide_density.pdf(x) * (wide_density.logpdf(x) - narrow_density.logpdf(x)), -0.2, 0.2
    )
    proposals = detect_quantization([build_residual(y, clean)])
    assert proposals[0].gain == pytest.approx(1.5 * divergence_per_sample * 3 * y.shape[1], rel=1e-6)


def test_the_lattice_step_is_found_though_one_axis_hardly_repeats_a_value():
    step = 0.012
    clean, y = draw_readings(np.random.default_rng(1), 400)
    clean[2] += np.linspace(0.0, 60.0, 400)
    y[2] += np.linspace(0.0, 60.0, 400)
    y[:3] = step * np.round(y[:3] / step)
    assert len(np.unique(y[2])) > 350
    assert find_lattice_step(build_residual(y, clean)) == pytest.approx(step, rel=1e-5)


def test_noise_far_above_the_rounding_error_is_not_explained_by_quantization():
    step = 0.02
    clean, y = draw_readings(np.random.default_rng(1))
    y[:3] = step * np.round((y[:3] + 0.06 * np.random.default_rng(2).standard_normal(y[:3].shape)) / step)
    residual = build_residual(y, clean)
    wide_sigma = np.concatenate([np.hypot(SIGMA[:3], 0.06), SIGMA[3:]])
    assert (
        detect_quantization([replace(residual, noise=replace(residual.noise, group_sigmas=wide_sigma))]) == []
    )
