"""Checks of the data received from a port: the rate of the node's clock."""

import re

import numpy as np
import pytest

from faults.line import HELLO
from hubodo.flash.reception import Reception
from hubodo.flash.reception_checks import check_reception


@pytest.mark.parametrize(
    ("ppm", "count", "verdict", "observation"),
    [
        (40.0, 60, "ok", r"\+40 ± 500 ppm against this host's, over 2\.0 s"),
        (-40.0, 60, "ok", "-40 ± "),
        (9000.0, 60, "wrong", r"\+9000 ± "),
        (40.0, 7, "unknown", "7 answers to requests"),
    ],
)
def test_the_clock_rate_is_estimated_from_the_fastest_answers(ppm, count, verdict, observation):
    """Every other answer was delayed by 30 ms on its way to the host; round trips of the others took 1 ms."""
    sent = np.arange(count) * 50_000_000
    round_trip = np.where(np.arange(count) % 2, 1_000_000, 31_000_000)
    node = ((sent + 500_000) * (1 + ppm * 1e-6)).astype(int)
    exchanges = list(zip((sent + round_trip // 2).tolist(), node.tolist(), round_trip.tolist(), strict=True))
    reception = Reception(n_frames=1, node=1, hello=HELLO, exchanges=exchanges)
    (clock,) = (result for result in check_reception(reception, 115200) if result.check == "clock")
    assert clock.verdict == verdict and re.search(observation, clock.observation), clock
