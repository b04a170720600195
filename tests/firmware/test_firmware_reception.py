"""A receiver of ESP-NOW restores the order of packets, ignores duplicates and counts what is missing."""

import numpy as np
import pytest
from framing import START
from outbox import Outbox
from radio import LAST
from radio.reception import Reception

from repetitions import first_and_more

HELD, HOLD_MS, REPLAY_WINDOW = 16, 30, 64


class Receiver:
    def __init__(self):
        self.outbox = Outbox(400, 1)
        self.reception = Reception(self.outbox)
        self.frames = []

    def add(self, *counts, ms=0):
        """Receive the packets with these counts since the start of the node; collect the forwarded frames."""
        for count in counts:
            body = bytes([1 + count % 255, 1 + count // 255, 7])
            self.reception.add((count - 1) % LAST + 1 if count else 0, b"\xff" + body + b"\xff", 1, 3, ms)
        self.collect()

    def step(self, ms):
        self.reception.step(ms)
        self.collect()

    def collect(self):
        while (slot := self.outbox.oldest()) is not None:
            frame = bytes(slot.raw[START : slot.end])
            assert frame[2:] == b"\7\0"
            self.frames.append(frame[0] - 1 + 255 * (frame[1] - 1))
            self.outbox.advance(slot.end - START - self.outbox.sent)

    def counts(self):
        return self.reception.frames, self.reception.lost, self.reception.repeated


@pytest.fixture
def receiver():
    return Receiver()


@pytest.mark.parametrize("seed", first_and_more(1, *range(2, 41)))
def test_late_and_repeated_packets_are_put_in_order_and_accepted_once(receiver, seed):
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    sent_ms = np.cumsum(rng.integers(3, 12, 1000))
    arrivals = [(int(t + rng.choice([0, 0, 0, 25]) + rng.random()), k) for k, t in enumerate(sent_ms) if k]
    repeats = [(t + int(rng.integers(1, 60)), k) for t, k in arrivals if rng.random() < 0.1]
    receiver.add(0)
    for ms, count in sorted([*arrivals, *repeats]):
        receiver.step(ms)
        receiver.add(count, ms=ms)
    assert receiver.frames == list(range(1000))
    assert receiver.counts() == (1000, 0, len(repeats))


@pytest.mark.parametrize("seed", first_and_more(1, *range(2, 41)))
def test_every_lost_packet_is_counted_and_the_others_stay_in_order(receiver, seed):
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    received = [0, *(np.flatnonzero(rng.random(2000) < 0.8) + 1).tolist()]
    for count in received:
        receiver.step(4 * count)
        receiver.add(count, ms=4 * count)
    for ms in range(8_000, 10_000, HOLD_MS):
        receiver.step(ms)
    assert receiver.frames == received
    assert receiver.counts() == (len(received), received[-1] + 1 - len(received), 0)


def test_a_frame_waits_for_the_one_before_it_no_longer_than_stated(receiver):
    receiver.add(0, 1, ms=10)
    receiver.add(3, 4, ms=50)
    receiver.step(50 + HOLD_MS - 1)
    assert receiver.frames == [0, 1]
    receiver.step(50 + HOLD_MS)
    assert receiver.frames == [0, 1, 3, 4] and receiver.counts() == (4, 1, 0)
    receiver.add(2, ms=51 + HOLD_MS)
    assert receiver.frames == [0, 1, 3, 4] and receiver.counts() == (4, 1, 1)


def test_frames_that_no_longer_fit_are_forwarded_at_once(receiver):
    receiver.add(0, *range(2, 2 + HELD - 1))
    assert receiver.frames == [0]
    receiver.add(2 + HELD - 1)
    assert receiver.frames == [0, *range(2, 2 + HELD)] and receiver.counts() == (HELD + 1, 1, 0)


@pytest.mark.parametrize(
    "behind, is_duplicate", [(1, True), (REPLAY_WINDOW, True), (REPLAY_WINDOW + 1, False)]
)
def test_numbers_up_to_the_replay_window_back_are_duplicates(receiver, behind, is_duplicate):
    receiver.add(*range(200))
    receiver.add(200 - behind)
    assert receiver.counts()[2] == is_duplicate


def test_a_restart_of_the_node_forwards_what_is_held_and_counts_no_loss_for_it(receiver):
    receiver.add(*range(50), 51, ms=10)
    receiver.add(0, ms=150)
    assert receiver.counts() == (51, 0, 1), "a duplicate of the first packet arrives within 0.2 s"
    receiver.add(0, 1, ms=400)
    assert receiver.frames == [*range(50), 51, 0, 1] and receiver.counts() == (53, 1, 1)


@pytest.mark.parametrize("first", [1, 64, LAST])
def test_the_first_number_may_be_any_and_earlier_ones_are_not_lost(receiver, first):
    receiver.add(first, first + 1, ms=5)
    assert receiver.frames == [first, first + 1] and receiver.counts() == (2, 0, 0)
