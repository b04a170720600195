"""What was heard from a port, judged without one: the clock by its quickest answers."""

import re

import numpy as np
import pytest

from faults.line import HELLO
from hubodo.flash.reception import Reception
from hubodo.flash.reception_checks import check_reception


@pytest.mark.parametrize(
    ("ppm", "count", "verdict", "words"),
    [
        (40.0, 60, "ok", r"\+40 ± 500 ppm against this host's, over 2\.0 s"),
        (-40.0, 60, "ok", "-40 ± "),
        (9000.0, 60, "wrong", r"\+9000 ± "),
        (40.0, 7, "unknown", "7 answers to requests"),
    ],
)
def test_a_clock_is_judged_by_the_quickest_answers(ppm, count, verdict, words):
    """Every other answer was held up for 30 ms on its way to the host; the others took 1 ms, evenly."""
    sent = np.arange(count) * 50_000_000
    trip = np.where(np.arange(count) % 2, 1_000_000, 31_000_000)
    node = ((sent + 500_000) * (1 + ppm * 1e-6)).astype(int)
    exchanges = list(zip((sent + trip // 2).tolist(), node.tolist(), trip.tolist(), strict=True))
    heard = Reception(n_frames=1, node=1, hello=HELLO, exchanges=exchanges)
    (clock,) = (result for result in check_reception(heard, 115200) if result.check == "clock")
    assert clock.verdict == verdict and re.search(words, clock.observation), clock
