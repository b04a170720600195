"""Nodes, an air that loses packets, a receiver, its USB: what is lost is counted there, the rest is whole."""

import numpy as np
import pytest

import hubowire
from hubodo.emulator.chips.faults import Stall
from hubodo.emulator.chips.nrf24 import PacketFaults
from hubowire import messages as m
from radio_rides import RECEIVER, nothing_lost, ride
from virtual_runs import all_lost, matched, of


@pytest.fixture(scope="module")
def rough():
    """A fifth of the packets lost, others twice, others late; all acknowledged."""
    return ride(PacketFaults(loss=0.2, duplication=0.05, delay=0.05))


def test_with_acknowledgements_a_fifth_of_the_packets_lost_loses_no_sample_of_two_nodes(rough):
    assert rough.air["packets lost"] > 200 and rough.air["answers lost"] > 80
    nothing_lost(rough)


def test_packets_that_come_twice_are_counted_and_change_nothing(rough):
    for k in rough.sent:
        assert rough.signal(k).pieces_twice > 3
        assert rough.signal(k).pieces > rough.signal(k).pieces_twice + 100


def test_a_receiver_says_who_it_is_and_that_it_samples_nothing(rough):
    hello = of(rough.of_receiver, m.Hello)[0]
    assert (hello.parts, hello.rate_mhz, hello.serial.hex()) == ((), 0, "e66141c8000000c8")


def test_without_acknowledgements_what_is_lost_is_the_frames_whose_packets_were_and_nothing_else():
    heard = ride(PacketFaults(loss=0.2), ids=(1,), tries=0)
    sent, truth = heard.sent[1], heard.truths[1]
    found = matched(sent, truth)
    assert np.array_equal(np.diff(found[:, 0]), np.diff(found[:, 2])), "what is missing is numbered"
    signals = [s for s in of(heard.of_receiver, m.Signal) if s.of_node == 1]
    at = max(i for i, (_, x) in enumerate(heard.of_receiver) if x is signals[-1])
    assert at > 0
    lost = all_lost(sent, since_boot=True)
    # An ImuBatch of 8 samples takes four packets: 0.8^4 of them come whole.
    batches = len(of(sent, m.ImuBatch))
    share = batches / (len(truth.t) / 8)
    assert abs(share - 0.8**4) < 0.15, share
    assert lost >= signals[-1].frames_lost > 0.8 * lost - 12
    assert heard.dropped[1] == 0, "the node has given up none: they were lost on the air"


def test_a_receiver_that_stands_still_makes_its_nodes_wait_and_only_they_give_up_the_oldest():
    heard = ride(PacketFaults(), faults=(Stall(1.0, seconds=1.4),), seconds=3.6)
    for k, sent in heard.sent.items():
        found = matched(sent, heard.truths[k])
        holes = np.flatnonzero(np.diff(found[:, 0]) != 1)
        assert np.array_equal(np.diff(found[:, 0]), np.diff(found[:, 2]))
        t = heard.truths[k].t[found[:, 0].astype(int)]
        assert all(t[hole] > 0.9 and t[hole + 1] < 2.6 for hole in holes)
        assert heard.dropped[k] == all_lost(sent) > 0
        assert heard.signal(k).frames_lost == 0, "what was sent has come"


def test_a_host_that_does_not_read_costs_frames_that_receiver_and_nodes_count():
    """But for what USB's port drops by itself, after half a second in which it holds the receiver up."""
    heard = ride(PacketFaults(), deaf=((0.8, 2.2),), seconds=3.6, cut=1)
    dropped = of(heard.of_receiver, m.Health)[-1].frames_dropped
    assert dropped > 0
    lost = sum(all_lost(sent) for sent in heard.sent.values()) + all_lost(heard.of_receiver)
    assert 0 <= lost - dropped - sum(heard.dropped.values()) <= 3
    assert all(heard.signal(k).frames_lost == 0 for k in heard.sent)


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
    heard = ride(PacketFaults(loss=0.1), script=script, seconds=2.1)
    answers = {k: [a.request_seq for a in of(sent, m.Ack)] for k, sent in heard.sent.items()}
    assert answers == {1: [71], 2: [72]}
    assert [a.request_seq for a in of(heard.of_receiver, m.Ack)] == [270]
    replies = of(heard.sent[1], m.TimeReply)
    assert [r.token for r in replies] == [bytes([65 + k] * 8) for k in range(8)]
    delays = [r.received_us - (1_200_000 + 80_000 * k) for k, r in enumerate(replies)]
    assert all(0 < delay < 60_000 for delay in delays), delays
