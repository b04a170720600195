"""Checks of the data received from a port: the rate of the node's clock."""

import re
from dataclasses import replace

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


@pytest.mark.parametrize(
    ("part", "observation"),
    [
        ((0x6B, 0x69, 1), "LSM6DS33 at 0x6B"),
        ((0x68, 0x0F, 0), "BMI088 at 0x68"),
        ((0, 0x47, 0), "ICM42688 on SPI"),
        ((0x0C, 0x48, 0), "AK8963 at 0x0C"),
        ((0x6B, 0x68, 0), "0x6B answers 0x68: an unknown chip"),
    ],
)
def test_a_chip_is_named_by_its_part_or_by_its_identity(part, observation):
    reception = Reception(n_frames=1, node=1, hello=replace(HELLO, parts=(part,)))
    (sensor,) = (result for result in check_reception(reception, 115200) if result.check == "sensor")
    assert sensor.observation == observation
