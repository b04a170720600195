"""Unexplained residuals: noise that differs from its declaration."""

from dataclasses import replace

import numpy as np
import pytest

from gap_residuals import SIGMA, build_residual, draw_readings
from hubodo.gap.explain.unexplained import _list_noise


@pytest.mark.parametrize(("ratio", "comparison"), [(1.0, ""), (1.1, ""), (3.0, "larger"), (0.3, "smaller")])
def test_noise_that_differs_from_its_declaration_is_listed_for_each_channel(ratio, comparison):
    clean, y = draw_readings(np.random.default_rng(1))
    residual = build_residual(y, clean)
    lines = list(
        _list_noise({"left": replace(residual, noise=replace(residual.noise, group_sigmas=ratio * SIGMA))})
    )
    assert len(lines) == (6 if comparison else 0)
    assert all(f"noise {comparison} than declared" in line.looks_like for line in lines)
    assert all(f"{ratio:.2f} times what the model says" in line.looks_like for line in lines)
