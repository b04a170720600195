"""East seeking on a table without noise: each step follows the rule of Robert."""

import math

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.sensors.north.circular import wrap_angle
from hubodo.sensors.north.east import seek_east

HORIZONTAL = 5e-5
AZIMUTH = 0.7


class Table:
    """A table with a gyro whose bias grows by a constant from stop to stop, and the tally of its stops.

    disturbed: rad/s added to the middle stop of each maytag, by its number. known: estimates that the tally
    returns after each number of stops; the last one is repeated.
    """

    def __init__(self, known=((AZIMUTH, 0.01),), disturbed=None):
        self.angle, self.stops, self.angles_sent = 0.0, 0, []
        self.known, self.disturbed = known, disturbed or {}

    def turn_to(self, angle):
        self.angle = angle + 1e-3
        return self.angle

    def measure(self, seconds):
        self.seconds = seconds
        noise = -2 * self.disturbed.get(self.stops // 3, 0.0) * (self.stops % 3 == 1)
        rate = HORIZONTAL * math.cos(self.angle - AZIMUTH) + 1e-3 + 3e-6 * self.stops + noise
        return np.arange(4.0), np.full(4, rate)

    def add_stop(self, t, rate, angle):
        assert len(t) == len(rate)
        self.angles_sent.append(angle)
        self.stops += 1
        return float(rate.mean())

    def azimuth(self):
        return self.known[min(self.stops, len(self.known) - 1)]


def seek(table, **options):
    return seek_east(table, table.measure, HORIZONTAL, tally=table, **options)


def measured(angle):
    return HORIZONTAL * math.cos(angle + 1e-3 - AZIMUTH)


def test_each_step_finds_its_component_whatever_bias_and_ramp_and_comes_back_from_halfway_round():
    table = Table(known=(None, (AZIMUTH, 0.01)))
    result = seek(table, steps=6, stop=12.0)
    assert table.seconds == 12.0 and table.stops == 18 and len(result.steps) == 6
    for step, reported in zip(result.steps, np.reshape(table.angles_sent, (6, 3)), strict=True):
        assert step.rate == pytest.approx(measured(step.angle), abs=1e-9 * HORIZONTAL)
        assert reported == pytest.approx(np.array([0.0, math.pi, 0.0]) + step.angle + 1e-3)


def test_from_nowhere_two_steps_a_quarter_turn_apart_say_where_east_is_and_the_last_one_looks_north():
    """East is clockwise of north seen from above: its angle is a quarter turn less than that of north."""
    table = Table(known=(None, (AZIMUTH, 0.01)))
    result = seek(table, steps=5)
    angles = [step.angle for step in result.steps]
    assert angles[:2] == [0.0, math.pi / 2]
    assert angles[2:4] == pytest.approx([AZIMUTH - math.pi / 2 - 1e-3] * 2)
    assert angles[4] == pytest.approx(AZIMUTH - 1e-3) and result.steps[4].rate == pytest.approx(HORIZONTAL)
    assert result.angle == pytest.approx(AZIMUTH - math.pi / 2 - 1e-3)
    assert (result.azimuth, result.sigma) == (AZIMUTH, 0.01)


def test_what_is_known_of_north_replaces_the_two_steps():
    table = Table(known=((AZIMUTH + 0.2, 0.1), (AZIMUTH, 0.01)))
    assert seek(table, steps=4).steps[0].angle == pytest.approx(AZIMUTH + 0.2 - math.pi / 2)


@pytest.mark.parametrize("nowhere", [True, False])
def test_noise_of_a_step_turns_the_table_by_its_share_of_all_steps(nowhere):
    """Stochastic approximation: the n-th measurement of east has the weight 1/n; the first one is a start."""
    first = 2 if nowhere else 0
    wrong = 0.02 * HORIZONTAL
    for number in range(first, 4):
        start = None if nowhere else (AZIMUTH - 1e-3, 0.01)
        table = Table((start, (AZIMUTH, 0.01)), {number: wrong})
        angles = [step.angle for step in seek(table, steps=7).steps]
        looks = number - first + 2
        turned = math.asin(0.02) / looks
        assert angles[number] - angles[number + 1] == pytest.approx(turned, abs=1e-6)
        # The next measurement removes its own share of the remaining error.
        assert angles[number + 2] - angles[number + 1] == pytest.approx(turned / (looks + 1), rel=1e-3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_step_that_reads_more_than_earth_rate_turns_by_no_more_than_a_quarter(sign):
    table = Table(((AZIMUTH - 1e-3, 0.01),), {0: sign * 5 * HORIZONTAL})
    angles = [step.angle for step in seek(table, steps=4).steps]
    assert angles[0] - angles[1] == pytest.approx(sign * math.pi / 2 / 2)


@pytest.mark.parametrize("off", [0.0, 1.0, math.pi])
def test_a_loop_that_stood_at_west_is_turned_about_by_its_last_step(off):
    table = Table(((AZIMUTH + off, 0.01), (AZIMUTH, 0.01)))
    result = seek(table, steps=30)
    assert wrap_angle(result.angle - (AZIMUTH - math.pi / 2)) == pytest.approx(0.0, abs=0.05)
    assert -math.pi < result.angle <= math.pi


@pytest.mark.parametrize("sigma, steps", [(0.05, 9), (0.03, 5), (None, 9)])
def test_it_ends_where_all_stops_together_are_as_sure_as_was_asked(sigma, steps):
    """Twelve stops determine it to 0.03: four steps, and the one that points north."""
    known = [(AZIMUTH, 0.1)] * 12 + [(AZIMUTH, 0.03)] if sigma == 0.03 else [(AZIMUTH, 0.1)]
    assert len(seek(Table(known), steps=9, sigma=sigma).steps) == steps


def test_three_steps_cannot_close_the_loop():
    with pytest.raises(InputError, match="4 or more"):
        seek(Table(), steps=3)
    assert len(seek(Table(), steps=4).steps) == 4
