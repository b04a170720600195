"""Unexplained residuals: noise that differs from its declaration."""

from dataclasses import replace

import numpy as np
import pytest

from gap_residuals import SIGMA, shown, white
from hubodo.gap.explain.unexplained import _list_noise


@pytest.mark.parametrize(("times", "words"), [(1.0, ""), (1.1, ""), (3.0, "larger"), (0.3, "smaller")])
def test_noise_is_worth_a_line_where_it_is_not_as_declared(times, words):
    clean, y = white(np.random.default_rng(1))
    one = shown(y, clean)
    said = list(_list_noise({"left": replace(one, noise=replace(one.noise, group_sigmas=times * SIGMA))}))
    assert len(said) == (6 if words else 0)
    assert all(f"noise {words} than declared" in line.looks_like for line in said)
    assert all(f"{times:.2f} times what the model says" in line.looks_like for line in said)
