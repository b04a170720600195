"""The sample clock at any phase between polls and samples: times are within bounds, numbers stay true."""

import random

import numpy as np
import pytest
import sample_clock
from sample_clock import SampleClock
from small_int import SmallInt

from fakes import fake_port
from fakes.fake_port import PORT_TICKS
from repetitions import each_value_first


class PolledSamples:
    """Samples at a constant period, polled at the times that the sample clock gives.

    errors: (time of the poll, time error of the newest sample, half width of its window), us.
    """

    def __init__(self, period_us, nominal_us, *, number=int, slack_us=3.0, seed=1):
        self.rng, self.number, self.slack_us = random.Random(seed), number, slack_us
        self.period_us, self.t_us, self.n_counted = period_us, 0.0, 0
        self.zero_us = self.rng.random() * period_us
        PORT_TICKS.now_us = 0
        self.clock = SampleClock()
        self.clock.start(number(round(nominal_us * 1000)))
        self.errors: list[tuple[float, float, float]] = []

    def count_until(self, t_us):
        return max(0, int((t_us - self.zero_us) // self.period_us))

    def time_of(self, count):
        return self.zero_us + count * self.period_us

    def poll(self, after_us):
        """Poll `after_us` from now with a time uncertainty of `slack_us`; return the new samples."""
        self.t_us += after_us
        new = self.count_until(self.t_us) - self.n_counted
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

    def poll_as_sampler(self, batch):
        """Poll when a sampler would."""
        clock = self.clock
        ahead = 1 if clock.is_wide() else batch - (self.n_counted % batch)
        due = fake_port.ticks_diff(int(clock.aim_us(self.number(ahead))), int(self.t_us) % fake_port.TICKS)
        self.poll(max(due + self.rng.uniform(-50, 80), 20))


def converged_clock(period_us=2400.0):
    """Return a clock with a converged period, just after a sample."""
    polled = PolledSamples(period_us, period_us)
    while polled.t_us < 4e6:
        polled.poll_as_sampler(16)
    clock = polled.clock
    assert clock.locked and clock.half_ns < 60_000
    return clock


@pytest.mark.parametrize("early", [True, False])
def test_a_contradiction_of_some_microseconds_moves_the_window_half_way(early):
    """The sample seems to be 15 us before its window, or 15 us after it."""
    clock = converged_clock()
    period_ns, doubt_ns = clock.period_ns, clock._doubt_ns
    center_us, half_ns = clock.ahead_us(1), clock.half_ahead_ns(1)
    jitter, offset_ns = 5000, half_ns + 15_000
    if early:
        late_us = center_us - (offset_ns + jitter) // 1000
        clock.update(late_us - 30, late_us, 1)
    else:
        early_us = center_us + (offset_ns + jitter + doubt_ns) // 1000 + period_ns // 1000
        clock.update(early_us, early_us + 30, 1)
    assert abs((clock.t_us - center_us) * 1000) == pytest.approx(half_ns + 7500, abs=2500)
    assert (clock.t_us < center_us) == early
    assert 15_000 <= clock.half_ns <= 23_000 and clock.locked
    assert (clock.period_ns, clock._doubt_ns) == (period_ns, doubt_ns), "the period uncertainty is unchanged"


@pytest.mark.parametrize("early", [True, False])
@pytest.mark.parametrize("missed_us", [30, 200, 800, 2000, 3000])
def test_a_sample_far_from_its_window_is_accepted_and_increases_the_period_uncertainty(missed_us, early):
    """The deviation is attributed to eight samples; the window gets its width, at most half a period."""
    clock = converged_clock()
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
    assert abs(edge) <= 2, "one edge of the window is the time of the poll"
    assert clock.half_ns == pytest.approx(min(max(half_ns, 1000 * missed_us), clock.period_ns / 2), abs=2500)
    assert clock._doubt_ns == pytest.approx(min(125 * missed_us + 2 * doubt_ns, clock.period_ns / 8), abs=400)
    # Limits of the lock: 1/8 of a period (300 us) for the window, 1/32 (75 us) for the uncertainty.
    assert clock.locked == (missed_us <= 200)
    assert clock._count == 0


@pytest.mark.parametrize(
    ("beyond_us", "identified"), [(-5000, True), (-20, True), (20, False), (5000, False)]
)
def test_a_sample_is_identified_only_if_the_poll_cannot_contain_another_one(beyond_us, identified):
    """Windows of half width h at intervals T are both within reach of a poll wider than T - 2 h."""
    polled = PolledSamples(10_000.0, 10_000.0)
    while polled.n_counted < 4:
        polled.poll(400.0)
    half_us = polled.clock.half_ahead_ns(1) / 1000
    assert 0.05 < 2 * half_us / 10_000 < 0.25
    early = polled.clock.ahead_us(1) - 500
    assert polled.clock.identifies(early, early + round(10_000 - 2 * half_us) + beyond_us) == identified


@pytest.mark.parametrize(
    ("rate", "rate_error", "seed"),
    each_value_first([12.5, 50, 104, 416, 1000, 1660], [-0.1, -0.03, 0.0, 0.05, 0.1], range(1, 4)),
)
def test_the_window_contains_the_true_time_and_becomes_narrow(rate, rate_error, seed):
    """This holds for any rate error of the chip, with polls per batch that are slightly early or late."""
    nominal_us = 1e6 / rate
    polled = PolledSamples(nominal_us / (1 + rate_error), nominal_us, seed=seed)
    while polled.t_us < 6e6:
        polled.poll_as_sampler(16)
    t, error, half = np.array(polled.errors).T
    assert np.all(np.abs(error) <= half + 6), (
        "the true time is within the window, except for the allowed jitter"
    )
    converged = t > max(1e6, 30 * nominal_us)
    polls = len(t) / (6 * rate / 16)
    print(f"seed {seed}: worst {np.abs(error[converged]).max():.0f} us, {polls:.2f} looks per 16")
    assert np.abs(error[converged]).max() < (100 if rate > 13 else 200)
    assert polled.clock.locked and polled.clock.period_ns / 1000 == pytest.approx(polled.period_us, rel=1e-4)


def test_a_drifting_rate_is_followed():
    """The rate drifts by 20 ppm per second, ten times that of a chip during warm-up."""
    polled = PolledSamples(2400.0, 2403.846)
    while polled.t_us < 20e6:
        polled.poll_as_sampler(16)
        if polled.count_until(polled.t_us) == polled.n_counted:
            # The period changes from here on: the time of the newest sample does not.
            now = polled.time_of(polled.n_counted)
            polled.period_us *= 1 - 20e-6 * 0.0384
            polled.zero_us = now - polled.n_counted * polled.period_us
    t, error, _ = np.array(polled.errors).T
    print(f"worst {np.abs(error[t > 1e6]).max():.0f} us, {polled.period_us:.2f} us in the end")
    assert np.abs(error[t > 1e6]).max() < 150 and polled.period_us < 2400.0 * 0.9997


@pytest.mark.parametrize("ratio", [0.98, 1.02, 1.1])
def test_the_clock_converges_again_after_a_rate_step(ratio):
    polled = PolledSamples(2400.0, 2403.846)
    while polled.t_us < 6e6:
        polled.poll_as_sampler(16)
        if polled.t_us > 3e6 and polled.period_us == 2400.0:
            now = polled.time_of(polled.n_counted)
            polled.period_us *= ratio
            polled.zero_us = now - polled.n_counted * polled.period_us
    t, error, _ = np.array(polled.errors).T
    print(f"worst on the way {np.abs(error[t > 3e6]).max():.0f} us")
    assert np.abs(error[t > 4e6]).max() < 100
    assert polled.clock.index == polled.n_counted - 1


def test_every_intermediate_of_the_clock_is_a_small_integer(monkeypatch):
    """Slowest and fastest periods, polls up to a full FIFO apart, and two wraps of the ticks are tested."""

    def small(function):
        return lambda *arguments: SmallInt.of(function(*(int(argument) for argument in arguments)))

    monkeypatch.setattr(sample_clock, "ticks_add", small(fake_port.ticks_add))
    monkeypatch.setattr(sample_clock, "ticks_diff", small(fake_port.ticks_diff))
    rng = random.Random(5)
    for period_us in (100_000.0, 80_000.0, 2403.846, 602.409):
        polled = PolledSamples(period_us * 1.1, period_us, number=SmallInt)
        clock = polled.clock
        while polled.t_us < 3 * 2**30:
            at = SmallInt(int(polled.t_us) % fake_port.TICKS)
            lost = clock.skipped(at, SmallInt(682))
            clock.late_us(at, SmallInt(682))
            (
                clock.is_certain(at, fake_port.ticks_add(at, 50), SmallInt(682)),
                clock.is_before(at, SmallInt(682)),
            )
            if lost and rng.random() < 0.1:
                clock.gap(lost)
            polled.poll(rng.choice((period_us, 16 * period_us, 90_000.0, 682 * period_us, 3e7)))
            polled.poll(1.0)
            for samples in (-682, -1, 1, 682, int(1e8 / period_us)):
                clock.ahead_us(SmallInt(samples)), clock.aim_us(SmallInt(abs(samples)))
            if rng.random() < 0.01:
                clock.rephase()
            # The sender reduces the sample number modulo 2^16; its own bound is years away.
            clock.index = SmallInt(int(clock.index) & 0xFFFF)
    assert SmallInt.widest > 1 << 28, "the test must come near the bound"
