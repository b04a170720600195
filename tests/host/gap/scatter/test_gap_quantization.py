"""Detection of quantization, against explicit log densities."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from gap_residuals import SEEDS, SIGMA, build_residual, draw_readings
from hubodo.gap.scatter.quantization import detect_quantization, find_lattice_step


def quantize(y, step):
    """Return readings, (6, N), with the gyros rounded to multiples of a step."""
    return np.concatenate([step * np.round(y[:3] / step), y[3:]])


def with_noise(residual, gyro_sigma):
    """Return a residual whose gyro noise is estimated as `gyro_sigma`, rounding included."""
    sigmas = np.concatenate([np.full((3, 1), gyro_sigma), SIGMA[3:]])
    return replace(residual, noise=replace(residual.noise, group_sigmas=sigmas))


@pytest.mark.parametrize("noise", [SIGMA[0, 0], 0.4 * SIGMA[0, 0], 2.0 * SIGMA[0, 0]])
@pytest.mark.parametrize("seed", SEEDS)
def test_the_gain_of_quantization_is_the_divergence_by_the_rounding_variance(seed, noise):
    """The Kullback-Leibler divergence of a Gaussian with the rounding variance from one without it."""
    step = 0.04
    clean, y = draw_readings(np.random.default_rng(seed))
    total = float(np.hypot(noise, step / np.sqrt(12.0)))
    residual = with_noise(build_residual(quantize(y, step), clean), total)
    assert find_lattice_step(residual) == pytest.approx(step, rel=1e-5)
    (proposal,) = detect_quantization([residual])
    narrow, wide = norm(scale=noise), norm(scale=total)
    divergence, _ = quad(lambda x: wide.pdf(x) * (wide.logpdf(x) - narrow.logpdf(x)), -0.5, 0.5, limit=200)
    assert proposal.gain == pytest.approx(divergence * 3 * y.shape[1], rel=1e-4)
    assert proposal.is_exact


@pytest.mark.parametrize("seed", SEEDS)
def test_the_resolution_of_a_usual_sensor_is_no_effect_in_a_quiet_log(seed):
    """Rounding of a tenth of the declared sigma, in noise of a tenth of it."""
    clean, y = draw_readings(np.random.default_rng(seed))
    step = 0.1 * np.sqrt(12.0) * SIGMA[0, 0]
    residual = with_noise(
        build_residual(quantize(clean + 0.1 * (y - clean), step), clean), 0.15 * SIGMA[0, 0]
    )
    assert find_lattice_step(residual) == pytest.approx(step, rel=1e-4)
    assert detect_quantization([residual]) == []


def test_nodes_on_one_lattice_have_the_effect_together_though_noise_hides_it_in_one():
    step = 0.04
    clean, y = draw_readings(np.random.default_rng(1))
    nodes = [build_residual(quantize(y, step), clean, name=name) for name in ("left", "right")]
    nodes[1] = with_noise(nodes[1], 5.0)
    (proposal,) = detect_quantization(nodes)
    assert proposal.term.scope == "all"
    coarser = build_residual(quantize(y, 1.3 * step), clean, name="right")
    assert [it.term.scope for it in detect_quantization([nodes[0], coarser])] == ["left", "right"]


def test_the_lattice_step_is_found_though_one_axis_hardly_repeats_a_value():
    step = 0.012
    clean, y = draw_readings(np.random.default_rng(1), 400)
    clean[2] += np.linspace(0.0, 60.0, 400)
    y[2] += np.linspace(0.0, 60.0, 400)
    y[:3] = step * np.round(y[:3] / step)
    assert len(np.unique(y[2])) > 350
    assert find_lattice_step(build_residual(y, clean)) == pytest.approx(step, rel=1e-5)


def test_rounding_that_shows_at_standstill_alone_is_no_effect():
    """A tenth of the log is as quiet as the lattice, the others have 20 times its noise."""
    step = 0.02
    clean, y = draw_readings(np.random.default_rng(1))
    group = (np.arange(y.shape[1]) >= y.shape[1] // 10).astype(np.uint8)
    levels = np.array([1.5, 20.0]) * step / np.sqrt(12.0)
    y[:3] = clean[:3] + levels[group] * (y[:3] - clean[:3]) / SIGMA[:3]
    residual = build_residual(quantize(y, step), clean)
    sigmas = np.concatenate([np.tile(levels, (3, 1)), np.tile(SIGMA[3:], (1, 2))])
    noise = replace(residual.noise, group_sigmas=sigmas, group_indices=group)
    assert find_lattice_step(residual) == pytest.approx(step, rel=1e-4)
    assert detect_quantization([replace(residual, noise=noise)]) == []


def test_noise_far_above_the_rounding_error_is_not_explained_by_quantization():
    step = 0.02
    clean, y = draw_readings(np.random.default_rng(1))
    y[:3] = step * np.round((y[:3] + 0.06 * np.random.default_rng(2).standard_normal(y[:3].shape)) / step)
    residual = build_residual(y, clean)
    wide_sigma = np.concatenate([np.hypot(SIGMA[:3], 0.06), SIGMA[3:]])
    assert (
        detect_quantization([replace(residual, noise=replace(residual.noise, group_sigmas=wide_sigma))]) == []
    )
