"""Nodes, a lossy radio channel, a receiver and its USB: losses are counted, all other data is complete."""

import numpy as np
import pytest

import hubowire
from hubodo.emulator.chips.faults import Stall
from hubodo.emulator.chips.nrf24 import PacketFaults
from hubowire import messages as m
from radio_rides import RECEIVER, assert_nothing_lost, ride
from virtual_runs import count_missing_frames, match_samples, messages_of


@pytest.fixture(scope="module")
def rough():
    """Return a channel that loses a fifth of the packets, duplicates and delays others; all acknowledged."""
    return ride(PacketFaults(loss=0.2, duplication=0.05, delay=0.05))


def test_with_acknowledgements_a_fifth_of_the_packets_lost_loses_no_sample_of_two_nodes(rough):
    assert rough.air["packets lost"] > 200 and rough.air["answers lost"] > 80
    assert_nothing_lost(rough)


@pytest.mark.repeat
def test_five_nodes_at_104_hz_lose_no_sample_where_a_tenth_of_the_packets_is_lost():
    five = ride(PacketFaults(loss=0.1), ids=(1, 2, 3, 4, 5), rate_hz=104)
    assert_nothing_lost(five)


def test_repeated_packets_are_counted_and_ignored(rough):
    for k in rough.sent:
        assert rough.signal(k).pieces_twice > 3
        assert rough.signal(k).pieces > rough.signal(k).pieces_twice + 100


def test_a_receiver_identifies_itself_without_an_imu(rough):
    hello = messages_of(rough.of_receiver, m.Hello)[0]
    assert (hello.parts, hello.rate_mhz, hello.serial.hex()) == ((), 0, "e66141c8000000c8")


def test_without_acknowledgements_only_frames_with_lost_packets_are_lost():
    recorded = ride(PacketFaults(loss=0.2), ids=(1,), tries=0)
    sent, truth = recorded.sent[1], recorded.truths[1]
    matches = match_samples(sent, truth)
    assert np.array_equal(np.diff(matches[:, 0]), np.diff(matches[:, 2])), "what is missing is numbered"
    signals = [s for s in messages_of(recorded.of_receiver, m.Signal) if s.of_node == 1]
    at = max(i for i, (_, x) in enumerate(recorded.of_receiver) if x is signals[-1])
    assert at > 0
    # No later Hello shows that the first one was lost.
    lost = count_missing_frames(sent, since_boot=True) + (not messages_of(sent, m.Hello))
    # An ImuBatch of 8 samples takes four packets: a share of 0.8^4 arrives complete.
    batches = len(messages_of(sent, m.ImuBatch))
    share = batches / (len(truth.t) / 8)
    assert abs(share - 0.8**4) < 0.15, share
    assert lost >= signals[-1].frames_lost > 0.8 * lost - 12
    assert recorded.dropped[1] == 0, "the node has given up none: they were lost on the air"


def test_while_a_receiver_stops_its_nodes_queue_frames_and_drop_the_oldest():
    recorded = ride(PacketFaults(), ids=(1,), faults=(Stall(1.0, seconds=1.4),), seconds=3.6)
    for k, sent in recorded.sent.items():
        matches = match_samples(sent, recorded.truths[k])
        holes = np.flatnonzero(np.diff(matches[:, 0]) != 1)
        assert np.array_equal(np.diff(matches[:, 0]), np.diff(matches[:, 2]))
        t = recorded.truths[k].t[matches[:, 0].astype(int)]
        assert all(t[hole] > 0.9 and t[hole + 1] < 2.6 for hole in holes)
        assert recorded.dropped[k] == count_missing_frames(sent) > 0
        assert recorded.signal(k).frames_lost == 0, "what was sent has come"


@pytest.mark.repeat
def test_a_host_that_does_not_read_costs_frames_that_receiver_and_nodes_count():
    """Except frames that the USB port drops itself after blocking the receiver for half a second."""
    recorded = ride(PacketFaults(), host_pauses=((0.8, 2.2),), seconds=3.6, cut=1)
    dropped = messages_of(recorded.of_receiver, m.Health)[-1].frames_dropped
    assert dropped > 0
    lost = sum(count_missing_frames(sent) for sent in recorded.sent.values()) + count_missing_frames(
        recorded.of_receiver
    )
    assert 0 <= lost - dropped - sum(recorded.dropped.values()) <= 3
    assert all(recorded.signal(k).frames_lost == 0 for k in recorded.sent)


def test_requests_reach_the_node_that_they_are_for_in_its_acknowledgements():
    ask = [
        hubowire.encode_frame(hubowire.Frame(m.Ping.type_id, to, 70 + to, b"")) for to in (1, 2, RECEIVER, 9)
    ]
    times = [
        hubowire.encode_frame(
            hubowire.Frame(
                m.TimeRequest.type_id, 1, 100 + k, hubowire.encode(m.TimeRequest(bytes([65 + k] * 8)))
            )
        )
        for k in range(8)
    ]
    script = [(1.0, b"\0" + b"".join(ask)), *((1.2 + 0.08 * k, b"\0" + times[k]) for k in range(8))]
    recorded = ride(PacketFaults(loss=0.1), script=script, seconds=2.1)
    answers = {k: [a.request_seq for a in messages_of(sent, m.Ack)] for k, sent in recorded.sent.items()}
    assert answers == {1: [71], 2: [72]}
    assert [a.request_seq for a in messages_of(recorded.of_receiver, m.Ack)] == [270]
    replies = messages_of(recorded.sent[1], m.TimeReply)
    assert [r.token for r in replies] == [bytes([65 + k] * 8) for k in range(8)]
    delays = [r.received_us - (1_200_000 + 80_000 * k) for k, r in enumerate(replies)]
    assert all(0 < delay < 60_000 for delay in delays), delays
