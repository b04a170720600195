"""Positions that jump and return: their detection, and a calibration without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from generators import wheel_drives
from hubodo.fuse.wheel.calibration.calibrate import calibrate_wheels
from hubodo.fuse.wheel.calibration.excursions import Jump, find_excursions
from hubodo.fuse.wheel.calibration.positions import Positions
from wheel_runs import config, skip_held_out_segments, tables

T = np.arange(40.0)


@pytest.mark.parametrize(
    "jumps, left_out",
    [
        ((), []),
        ((Jump(5, 1.0 + 0.5j), Jump(8, -0.9 - 0.6j)), [5, 6, 7]),
        ((Jump(5, 1j), Jump(6, 0.5), Jump(9, -0.4 - 0.9j)), [5, 6, 7, 8]),
        ((Jump(5, 1.0), Jump(8, 1j)), []),
        ((Jump(5, 1.0), Jump(16, -1.0)), []),
        ((Jump(5, 1.0), Jump(12, 1j), Jump(14, -1j)), [12, 13]),
        ((Jump(5, 1.0), Jump(6, -1.0), Jump(30, 1j), Jump(31, -1j)), [5, 30]),
    ],
    ids=["none", "returns", "two jumps away", "other direction", "too late", "beside a jump", "two"],
)
def test_an_excursion_lasts_from_a_jump_until_the_jump_that_returns(
    jumps: tuple[Jump, ...], left_out: list[int]
) -> None:
    assert np.flatnonzero(find_excursions(jumps, T)).tolist() == left_out


def test_a_calibration_leaves_out_excursions_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counted as jumps, excursions of 1.4 m enlarge the sigma of the radius by a half; left out, by 5 %."""
    skip_held_out_segments(monkeypatch)
    seed = 79
    rng = np.random.default_rng(seed)
    errors = replace(wheel_drives.Errors(), radius=0.01)
    drive = wheel_drives.drive(wheel_drives.loop(rng, 60.0, 6.0), rng, errors)
    t = np.arange(0.0, drive.t[-1], 0.5)
    white = 0.01 * rng.standard_normal((2, len(t)))
    x, y = np.interp(t, drive.t, drive.x) + white[0], np.interp(t, drive.t, drive.y) + white[1]
    results = {}
    for kind, size in (("steady", 0.0), ("excursions", 1.0)):
        off = size * (np.mod(t, 18.0) > 14.0)
        measured = Positions(t, x + off, y - off, np.full(len(t), 0.1))
        results[kind] = calibrate_wheels(config(drive), tables(drive), measured)
    assert "jumped and returned within seconds" in results["excursions"].warnings[-1], seed
    assert results["excursions"].n_jumps == 0
    assert results["steady"].warnings == results["excursions"].warnings[:-1]
    for name, node in drive.nodes.items():
        radius = {kind: result.nodes[name]["wheel_radius"]["error"] for kind, result in results.items()}
        assert radius["excursions"].sigma < 1.2 * radius["steady"].sigma, (seed, name)
        for quantity in radius.values():
            assert abs(quantity.value - node.truth["radius"]) < 4.0 * quantity.sigma, (seed, name)
