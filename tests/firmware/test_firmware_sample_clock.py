"""The clock of samples against beats of every kind: the truth lies within what it says, numbers stay true."""

import random

import numpy as np
import pytest
import sample_clock
from sample_clock import SampleClock
from small_int import SmallInt

from fakes import fake_port
from fakes.fake_port import PORT_TICKS


class Beat:
    """Samples of an even beat, looked at when the clock says so.

    errors: (time of the look, error of the time of the newest sample, half of its window), us.
    """

    def __init__(self, period_us, nominal_us, *, number=int, slack_us=3.0, seed=1):
        self.rng, self.number, self.slack_us = random.Random(seed), number, slack_us
        self.period_us, self.t_us, self.n_counted = period_us, 0.0, 0
        self.zero_us = self.rng.random() * period_us
        PORT_TICKS.now_us = 0
        self.clock = SampleClock()
        self.clock.start(number(round(nominal_us * 1000)))
        self.errors: list[tuple[float, float, float]] = []

    def taken_by(self, t_us):
        return max(0, int((t_us - self.zero_us) // self.period_us))

    def time_of(self, count):
        return self.zero_us + count * self.period_us

    def poll(self, after_us):
        """A look `after_us` from now, known to `slack_us`; True when samples were new."""
        self.t_us += after_us
        new = self.taken_by(self.t_us) - self.n_counted
        self.n_counted += new
        before = self.rng.random() * self.slack_us
        early, late = (
            int(t) % fake_port.TICKS for t in (self.t_us - before, self.t_us - before + self.slack_us + 1)
        )
        self.clock.update(self.number(early), self.number(late), self.number(new))
        if self.n_counted:
            ticks = self.time_of(self.n_counted) % fake_port.TICKS
            error = (
                int(self.clock.t_us) - ticks + fake_port.TICKS / 2
            ) % fake_port.TICKS - fake_port.TICKS / 2
            self.errors.append((self.t_us, error, self.clock.half_ns / 1000))
        return new

    def aimed(self, batch):
        """A look when a sampler would take it."""
        clock = self.clock
        ahead = 1 if clock.is_wide() else batch - (self.n_counted % batch)
        due = fake_port.ticks_diff(int(clock.aim_us(self.number(ahead))), int(self.t_us) % fake_port.TICKS)
        self.poll(max(due + self.rng.uniform(-50, 80), 20))


def settled(period_us=2400.0):
    """A clock that knows its beat, and the moment just after a sample."""
    beat = Beat(period_us, period_us)
    while beat.t_us < 4e6:
        beat.aimed(16)
    clock = beat.clock
    assert clock.locked and clock.half_ns < 60_000
    return clock


@pytest.mark.parametrize("early", [True, False])
def test_looks_that_contradict_each_other_by_some_microseconds_move_the_window_half_way(early):
    """The sample seems to have come 15 us before its window, or 15 us behind it."""
    clock = settled()
    period_ns, doubt_ns = clock.period_ns, clock._doubt_ns
    center_us, half_ns = clock.ahead_us(1), clock.half_ahead_ns(1)
    jitter, off = 5000, half_ns + 15_000
    if early:
        late_us = center_us - (off + jitter) // 1000
        clock.update(late_us - 30, late_us, 1)
    else:
        early_us = center_us + (off + jitter + doubt_ns) // 1000 + period_ns // 1000
        clock.update(early_us, early_us + 30, 1)
    assert abs((clock.t_us - center_us) * 1000) == pytest.approx(half_ns + 7500, abs=2500)
    assert (clock.t_us < center_us) == early
    assert 15_000 <= clock.half_ns <= 23_000 and clock.locked
    assert (clock.period_ns, clock._doubt_ns) == (period_ns, doubt_ns), "the beat is not doubted"


@pytest.mark.parametrize("early", [True, False])
@pytest.mark.parametrize("missed_us", [30, 200, 800, 2000, 3000])
def test_a_sample_that_comes_far_from_its_window_is_believed_and_the_beat_doubted(missed_us, early):
    """As if what was missed had come about in eight samples; the window is as wide, half a period at most."""
    clock = settled()
    clock._doubt_ns = doubt_ns = 20_000
    center_us, half_ns = clock.ahead_us(1), clock.half_ahead_ns(1)
    if early:
        late_us = center_us - half_ns // 1000 - 5 - missed_us
        clock.update(late_us - 30, late_us, 1)
        edge = clock.t_us + clock.half_ns // 1000 - (late_us + 5)
    else:
        early_us = center_us + (half_ns + 5000 + doubt_ns + clock.period_ns) // 1000 + missed_us
        expected = early_us - (clock.period_ns + doubt_ns + 5000) // 1000
        clock.update(early_us, early_us + 30, 1)
        edge = clock.t_us - clock.half_ns // 1000 - expected
    assert abs(edge) <= 2, "one edge of the window is where the look says"
    assert clock.half_ns == pytest.approx(min(max(half_ns, 1000 * missed_us), clock.period_ns / 2), abs=2500)
    assert clock._doubt_ns == pytest.approx(min(125 * missed_us + 2 * doubt_ns, clock.period_ns / 8), abs=400)
    # An eighth of a period, 300 us, and a 32nd, 75 us, are what it has to know.
    assert clock.locked == (missed_us <= 200)
    assert clock._count == 0


@pytest.mark.parametrize(
    ("beyond_us", "identified"), [(-5000, True), (-20, True), (20, False), (5000, False)]
)
def test_a_sample_has_its_number_only_if_no_other_of_the_beat_could_have_come_instead(beyond_us, identified):
    """Windows of half width h, a period T apart: both touch what is wider than T - 2 h."""
    beat = Beat(10_000.0, 10_000.0)
    while beat.n_counted < 4:
        beat.poll(400.0)
    half_us = beat.clock.half_ahead_ns(1) / 1000
    assert 0.05 < 2 * half_us / 10_000 < 0.25
    early = beat.clock.ahead_us(1) - 500
    assert beat.clock.identifies(early, early + round(10_000 - 2 * half_us) + beyond_us) == identified


@pytest.mark.parametrize("seed", range(1, 4))
@pytest.mark.parametrize("wrong", [-0.1, -0.03, 0.0, 0.05, 0.1])
@pytest.mark.parametrize("rate", [12.5, 50, 104, 416, 1000, 1660])
def test_the_true_time_is_in_the_window_and_the_window_becomes_narrow(rate, wrong, seed):
    """Whatever the part's own rate, in steps of a batch, with looks that come somewhat early or late."""
    nominal_us = 1e6 / rate
    beat = Beat(nominal_us / (1 + wrong), nominal_us, seed=seed)
    while beat.t_us < 6e6:
        beat.aimed(16)
    t, error, half = np.array(beat.errors).T
    assert np.all(np.abs(error) <= half + 6), "within the window, but for the jitter that is allowed"
    settled = t > max(1e6, 30 * nominal_us)
    looks = len(t) / (6 * rate / 16)
    print(f"seed {seed}: worst {np.abs(error[settled]).max():.0f} us, {looks:.2f} looks per 16")
    assert np.abs(error[settled]).max() < (100 if rate > 13 else 200)
    assert beat.clock.locked and beat.clock.period_ns / 1000 == pytest.approx(beat.period_us, rel=1e-4)


def test_a_beat_that_wanders_is_followed():
    """20 parts in a million faster every second, ten times what a chip does that warms up."""
    beat = Beat(2400.0, 2403.846)
    while beat.t_us < 20e6:
        beat.aimed(16)
        if beat.taken_by(beat.t_us) == beat.n_counted:
            # The beat changes from here on: the newest sample stays where it was.
            now = beat.time_of(beat.n_counted)
            beat.period_us *= 1 - 20e-6 * 0.0384
            beat.zero_us = now - beat.n_counted * beat.period_us
    t, error, _ = np.array(beat.errors).T
    print(f"worst {np.abs(error[t > 1e6]).max():.0f} us, {beat.period_us:.2f} us in the end")
    assert np.abs(error[t > 1e6]).max() < 150 and beat.period_us < 2400.0 * 0.9997


@pytest.mark.parametrize("ratio", [0.98, 1.02, 1.1])
def test_after_a_step_of_the_beat_the_window_is_found_again(ratio):
    beat = Beat(2400.0, 2403.846)
    while beat.t_us < 6e6:
        beat.aimed(16)
        if beat.t_us > 3e6 and beat.period_us == 2400.0:
            now = beat.time_of(beat.n_counted)
            beat.period_us *= ratio
            beat.zero_us = now - beat.n_counted * beat.period_us
    t, error, _ = np.array(beat.errors).T
    print(f"worst on the way {np.abs(error[t > 3e6]).max():.0f} us")
    assert np.abs(error[t > 4e6]).max() < 100
    assert beat.clock.index == beat.n_counted - 1


def test_every_intermediate_of_the_clock_is_a_small_integer(monkeypatch):
    """Slowest and fastest periods, looks up to a whole FIFO apart, over two turns of the ticks."""

    def small(function):
        return lambda *words: SmallInt.of(function(*(int(word) for word in words)))

    monkeypatch.setattr(sample_clock, "ticks_add", small(fake_port.ticks_add))
    monkeypatch.setattr(sample_clock, "ticks_diff", small(fake_port.ticks_diff))
    rng = random.Random(5)
    for period_us in (100_000.0, 80_000.0, 2403.846, 602.409):
        beat = Beat(period_us * 1.1, period_us, number=SmallInt)
        clock = beat.clock
        while beat.t_us < 3 * 2**30:
            at = SmallInt(int(beat.t_us) % fake_port.TICKS)
            lost = clock.skipped(at, SmallInt(682))
            clock.late_us(at, SmallInt(682))
            (
                clock.is_certain(at, fake_port.ticks_add(at, 50), SmallInt(682)),
                clock.is_before(at, SmallInt(682)),
            )
            if lost and rng.random() < 0.1:
                clock.gap(lost)
            beat.poll(rng.choice((period_us, 16 * period_us, 90_000.0, 682 * period_us, 3e7)))
            beat.poll(1.0)
            for samples in (-682, -1, 1, 682, int(1e8 / period_us)):
                clock.ahead_us(SmallInt(samples)), clock.aim_us(SmallInt(abs(samples)))
            if rng.random() < 0.01:
                clock.rephase()
            # The chip's number is kept modulo 2^16 by who sends it; its own bound is years away.
            clock.index = SmallInt(int(clock.index) & 0xFFFF)
    assert SmallInt.widest > 1 << 28, "the test must come near the bound to mean anything"
