"""Frames by radio arrive in pieces that get lost, duplicated or reordered: a receiver reassembles them."""

import numpy as np
import pytest
from framing import START
from outbox import Outbox
from radio.pieces import Pieces

PIECE, HEAD, LATE_MS = 30, 2, 2000
"""As the README of the wire has them."""


def frame_of(size, seed=0):
    """Return `size` bytes whose only zero is the last one."""
    return np.random.default_rng([size, seed]).integers(1, 256, size - 1, np.uint8).tobytes() + b"\0"


def packets_of(number, frame):
    parts = [frame[at : at + PIECE] for at in range(0, len(frame), PIECE)]
    return [bytes([number & 0xFF, k << 4 | len(parts) - 1]) + part for k, part in enumerate(parts)]


class Receiver:
    def __init__(self):
        self.outbox = Outbox(40, 1)
        self.pieces = Pieces(self.outbox)

    def add(self, *packets, ms=0):
        for packet in packets:
            # A packet is part of a longer buffer of the radio.
            self.pieces.add(b"\xff" + packet + b"\xff", 1, len(packet), ms)

    def frames(self):
        completed = []
        while (slot := self.outbox.oldest()) is not None:
            completed.append(bytes(slot.raw[START : slot.end]))
            self.outbox.advance(self.outbox.sent * -1 if self.outbox.sent < 0 else 0)
            self.outbox.advance(slot.end - START)
        return completed

    def counts(self):
        return self.pieces.frames, self.pieces.lost, self.pieces.repeated


@pytest.fixture
def receiver():
    return Receiver()


def test_frames_of_any_size_are_reassembled_from_pieces_in_any_order(receiver):
    rng = np.random.default_rng(1)
    for number, size in enumerate([*range(2, 251), *rng.integers(2, 251, 300)]):
        frame = frame_of(int(size), number)
        receiver.add(*rng.permutation(np.array(packets_of(number, frame), object)))
        assert receiver.frames() == [frame]
    assert receiver.counts() == (number + 1, 0, 0)


def test_pieces_of_two_frames_may_be_interleaved(receiver):
    first, second = frame_of(100), frame_of(90)
    a, b = packets_of(7, first), packets_of(8, second)
    receiver.add(a[0], b[0], a[1], b[1], b[2], a[2], a[3])
    assert receiver.frames() == [second, first] and receiver.counts() == (2, 0, 0)


def test_repeated_pieces_are_counted_and_delivered_once(receiver):
    frames = [frame_of(70, k) for k in range(16)]
    for k, frame in enumerate(frames):
        receiver.add(*packets_of(250 + k, frame), packets_of(250 + k, frame)[1])
    assert receiver.frames() == frames and receiver.counts() == (16, 0, 16)
    receiver.add(packets_of(250, frames[0])[0])
    assert receiver.counts() == (16, 0, 17) and receiver.frames() == []
    first, *_ = packets_of(255 + 11, frame_of(70))
    receiver.add(first, first)
    assert receiver.counts() == (16, 0, 18)


def test_missing_numbers_are_lost_until_they_arrive(receiver):
    frame = frame_of(20)
    receiver.add(*packets_of(10, frame), *packets_of(14, frame))
    assert receiver.counts() == (2, 3, 0)
    receiver.add(*packets_of(12, frame))
    assert receiver.counts() == (3, 2, 0)
    receiver.add(*packets_of(12, frame), *packets_of(10, frame))
    assert receiver.counts() == (3, 2, 2)


def test_of_three_incomplete_frames_the_oldest_is_dropped(receiver):
    frames = [frame_of(50, k) for k in range(3)]
    packets = [packets_of(k, frame) for k, frame in enumerate(frames)]
    for k in range(3):
        receiver.add(packets[k][0], ms=100 * k)
    assert receiver.counts() == (0, 1, 0)
    receiver.add(packets[2][1], packets[1][1], packets[0][1], ms=300)
    assert receiver.frames() == [frames[2], frames[1]] and receiver.counts() == (2, 1, 1)


@pytest.mark.parametrize("waited, lost", [(LATE_MS, 0), (LATE_MS + 1, 1)])
def test_an_incomplete_frame_is_dropped_after_two_seconds(receiver, waited, lost):
    frame = frame_of(50)
    packets = packets_of(3, frame)
    receiver.add(packets[0], ms=1000)
    receiver.pieces.step(1000 + waited)
    receiver.add(packets[1], ms=1000 + waited)
    assert receiver.frames() == ([] if lost else [frame])
    assert receiver.counts() == (1 - lost, lost, lost)


@pytest.mark.parametrize(
    "packet",
    [
        bytes([1, 0x00]),  # only a header;
        bytes([1, 0x09]) + bytes(30),  # ten pieces, more than the longest frame has;
        bytes([1, 0x21]) + b"abc",  # an index beyond the last piece;
        bytes([1, 0x01]) + bytes(29),  # a short piece before the last one.
    ],
)
def test_invalid_packets_are_ignored(receiver, packet):
    receiver.add(packet)
    assert receiver.frames() == [] and receiver.pieces.received == 1 and receiver.counts() == (0, 0, 0)
    frame, other = frame_of(250), frame_of(200)
    a, b = packets_of(0, frame), packets_of(255, other)
    receiver.add(*a[1:], packet, *b[1:], a[0], b[0])
    assert receiver.frames() == [frame, other]


def test_a_frame_beyond_the_longest_is_refused(receiver):
    receiver.add(*packets_of(1, frame_of(251)))
    assert receiver.frames() == []
    receiver.add(*packets_of(2, frame_of(250)))
    assert receiver.frames() == [frame_of(250)]


@pytest.mark.parametrize("first", [0, 1, 200, 255])
def test_the_first_number_may_be_any_and_earlier_ones_are_not_lost(receiver, first):
    for k in range(3):
        receiver.add(*packets_of(first + k, frame_of(31, k)))
    assert receiver.counts() == (3, 0, 0)


@pytest.mark.parametrize("n_overtaking, is_accepted", [(15, True), (16, False)])
@pytest.mark.parametrize("are_others_missing", [True, False])
def test_a_frame_overtaken_by_up_to_fifteen_others_is_accepted_once(
    receiver, n_overtaking, is_accepted, are_others_missing
):
    frame, newest = frame_of(20), 60 + n_overtaking
    receiver.add(*packets_of(59, frame))
    for number in [newest] if are_others_missing else range(61, newest + 1):
        receiver.add(*packets_of(number, frame))
    frames, lost, repeated = receiver.counts()
    assert lost == (n_overtaking if are_others_missing else 1) and repeated == 0
    receiver.add(*packets_of(60, frame))
    assert receiver.counts() == (frames + is_accepted, lost - is_accepted, repeated + (not is_accepted))
    receiver.add(*packets_of(60, frame), *packets_of(newest, frame), *packets_of(newest - 16, frame))
    assert receiver.counts()[0] == frames + is_accepted


def test_a_frame_with_a_zero_inside_is_refused(receiver):
    receiver.add(*packets_of(1, b"ab\0cd\0"), *packets_of(2, b"abcd"), *packets_of(3, b"abc\0"))
    assert receiver.frames() == [b"abc\0"] and receiver.counts() == (1, 2, 0)
