"""Detection of quantization, against densities written out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from gap_residuals import SEEDS, SIGMA, shown, white
from hubodo.gap.scatter.quantization import detect_quantization, find_lattice_step


@pytest.mark.parametrize("seed", SEEDS)
def test_coarse_steps_gain_the_density_with_the_variance_of_rounding_in_it(seed):
    """Wild readings are left to another likelihood."""
    step = 0.04
    clean, y = white(np.random.default_rng(seed))
    y[:3] = step * np.round(y[:3] / step)
    y[0, ::100] += 10.0 * step
    one = shown(y, clean)
    assert find_lattice_step(one) == pytest.approx(step, rel=1e-5)
    found = detect_quantization([one])
    assert [it.term.effect.name for it in found] == ["gyro_quantization"]
    wide = np.sqrt(SIGMA[:3] ** 2 + step**2 / 12.0)
    off = one.value[:3]
    calm = np.abs(off) < 4.0 * wide
    each = norm.logpdf(off, scale=wide) - norm.logpdf(off, scale=SIGMA[:3])
    assert found[0].gain == pytest.approx(float(each[calm].sum()), rel=1e-9)


def test_coarse_steps_get_no_more_credit_than_one_and_a_half_times_what_they_are_worth():
    """Where the noise is larger for other reasons; worth: divergence of the wider density, by quadrature."""
    step = 0.04
    rng = np.random.default_rng(1)
    clean, y = white(rng)
    y[:3] = step * np.round((y[:3] + 0.03 * rng.standard_normal(y[:3].shape)) / step)
    narrow = norm(scale=SIGMA[0, 0])
    wide = norm(scale=np.hypot(SIGMA[0, 0], step / np.sqrt(12.0)))
    worth, _ = quad(lambda x: wide.pdf(x) * (wide.logpdf(x) - narrow.logpdf(x)), -0.2, 0.2)
    found = detect_quantization([shown(y, clean)])
    assert found[0].gain == pytest.approx(1.5 * worth * 3 * y.shape[1], rel=1e-6)


def test_a_lattice_is_seen_in_a_log_in_which_one_axis_hardly_reads_anything_twice():
    step = 0.012
    clean, y = white(np.random.default_rng(1), 400)
    clean[2] += np.linspace(0.0, 60.0, 400)
    y[2] += np.linspace(0.0, 60.0, 400)
    y[:3] = step * np.round(y[:3] / step)
    assert len(np.unique(y[2])) > 350
    assert find_lattice_step(shown(y, clean)) == pytest.approx(step, rel=1e-5)


def test_noise_that_is_far_larger_than_rounding_is_none_of_its_making():
    step = 0.02
    clean, y = white(np.random.default_rng(1))
    y[:3] = step * np.round((y[:3] + 0.06 * np.random.default_rng(2).standard_normal(y[:3].shape)) / step)
    one = shown(y, clean)
    wide = np.concatenate([np.hypot(SIGMA[:3], 0.06), SIGMA[3:]])
    assert detect_quantization([replace(one, noise=replace(one.noise, group_sigmas=wide))]) == []
