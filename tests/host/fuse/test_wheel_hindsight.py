"""Doubts after a slip: where a speed that was carried may have been wrong, the place is, too."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hubodo.fuse.wheel.entries import HEADING, SPEED, X, Y
from hubodo.fuse.wheel.hindsight import Hindsight

ENTRIES = (X, Y, HEADING, SPEED)


def followed(slip: float, spun: int = 20) -> Any:
    """A core whose one wheel is back on the road, after it spun for so many windows; and its hindsight."""
    rng = np.random.default_rng(4)
    headings = 0.4 + np.cumsum(0.02 * rng.standard_normal(400))
    made = Hindsight(SimpleNamespace())  # type: ignore[arg-type]
    for heading in headings:
        made._headings.append(heading)
    core = SimpleNamespace(
        p=np.zeros((4, 4)), columns=SimpleNamespace(vehicle={name: k for k, name in enumerate(ENTRIES)})
    )
    spell = SimpleNamespace(begin=3.0, end=3.0 + 0.1 * spun)
    made._doubt(core, slip, 0.04, spell)  # type: ignore[arg-type]
    return core.p, headings


@pytest.mark.parametrize("slip", [1.5, -1.5])
def test_a_speed_that_was_wrong_may_have_been_so_all_the_while_wherever_it_headed(slip: float) -> None:
    """Beside all speeds that are off by no more: none takes the place further off than is doubted."""
    p, headings = followed(slip)
    wrong = slip**2 - 0.04
    assert p[3, 3] == pytest.approx(wrong)
    # Through the slip, and six seconds before, as old as one may be when it is found.
    ahead = np.exp(1j * headings[-80:])
    way = np.array([ahead.real, ahead.imag])
    expected = wrong * 8.0 * (way @ way.T) * 0.1
    assert p[:2, :2] == pytest.approx(expected)
    rng = np.random.default_rng(5)
    for _ in range(50):
        off = math.sqrt(wrong) * np.clip(rng.standard_normal(80).cumsum() * 0.3, -1.0, 1.0)
        place = 0.1 * (way @ off)
        assert place @ np.linalg.solve(p[:2, :2], place) <= 1.0


def test_a_slip_no_larger_than_its_sigma_is_no_reason_to_doubt() -> None:
    for slip, doubted in ((0.19, False), (0.21, True)):
        assert followed(slip)[0].any() == doubted
