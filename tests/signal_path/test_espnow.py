"""Nodes by ESP-NOW to a receiver: lost packets are retransmitted, dropped frames are counted."""

import numpy as np
import pytest

import hubowire
from hubodo.emulator.board.radio_medium import RadioMedium
from hubodo.emulator.chips.espnow import (
    ARG,
    EXIST,
    FULL,
    MAX_PACKET_BYTES,
    MAX_PEERS,
    NO_MEM,
    NOT_FOUND,
    NOT_INIT,
    EspNow,
    EspNowCall,
)
from hubodo.emulator.chips.faults import Stall
from hubodo.emulator.chips.nrf24 import PacketFaults
from hubowire import messages as m
from radio_rides import RECEIVER, assert_nothing_lost, ride
from virtual_runs import count_missing_frames, match_samples, messages_of

ON = bytes([EspNowCall.ACTIVE]) + b"\1\0" + (526).to_bytes(2, "little")


@pytest.fixture(scope="module")
def rough():
    """Return a channel that loses a fifth of packets and acknowledgements, and repeats or delays others."""
    return ride(PacketFaults(loss=0.2, duplication=0.05, delay=0.05), link="espnow")


def test_a_fifth_of_the_packets_lost_and_others_late_lose_no_sample_of_two_nodes(rough):
    assert rough.air["packets lost"] > 40 and rough.air["answers lost"] > 30
    assert_nothing_lost(rough)


def test_five_nodes_at_416_hz_reach_a_host_on_the_uart_of_their_receiver():
    five = ride(PacketFaults(loss=0.2), link="espnow", ids=(1, 2, 3, 4, 5), rate_hz=416, over_uart=True)
    assert_nothing_lost(five)


@pytest.mark.repeat
@pytest.mark.parametrize("seed", range(1, 13))
def test_packets_that_others_overtake_lose_no_sample(seed):
    assert_nothing_lost(ride(PacketFaults(loss=0.2, duplication=0.1, delay=0.3), link="espnow", seed=seed))


def test_repeated_packets_are_counted_and_ignored(rough):
    signals = [rough.signal(k) for k in rough.sent]
    assert sum(signal.pieces_twice for signal in signals) > 5
    for signal in signals:
        assert signal.pieces == signal.pieces_strong == signal.frames + signal.pieces_twice


def test_a_stopped_receiver_counts_packets_that_overflow_its_buffer():
    recorded = ride(PacketFaults(delay=0.05), link="espnow", faults=(Stall(1.0, seconds=1.4),), seconds=3.6)
    for k, sent in recorded.sent.items():
        matches = match_samples(sent, recorded.truths[k])
        assert np.array_equal(np.diff(matches[:, 0]), np.diff(matches[:, 2])), "what is missing is numbered"
        assert recorded.signal(k).frames_lost > 0
    at_receiver = messages_of(recorded.of_receiver, m.Health)[-1].frames_dropped
    on_the_way = sum(recorded.signal(k).frames_lost + recorded.dropped[k] for k in recorded.sent)
    # The last counters are at most one second old, and nothing was lost since.
    lost = sum(count_missing_frames(sent) for sent in recorded.sent.values()) + count_missing_frames(
        recorded.of_receiver
    )
    assert lost == on_the_way + at_receiver


def test_requests_reach_the_node_that_they_are_for():
    ask = [
        hubowire.encode_frame(hubowire.Frame(m.Ping.type_id, to, 70 + to, b"")) for to in (1, 2, RECEIVER, 9)
    ]
    recorded = ride(PacketFaults(), link="espnow", script=[(1.0, b"\0" + b"".join(ask))], seconds=2.4)
    answers = {k: [a.request_seq for a in messages_of(sent, m.Ack)] for k, sent in recorded.sent.items()}
    assert answers == {1: [71], 2: [72]}
    assert [a.request_seq for a in messages_of(recorded.of_receiver, m.Ack)] == [270]


def test_the_fake_station_refuses_the_same_calls_as_esp_now():
    station, mac = EspNow(RadioMedium(), b"\2\0\0\0\0\1"), b"\2\0\0\0\0\2"

    def call(what, data=b""):
        return station.handle_call(0.0, bytes([what]) + data)[0]

    assert call(EspNowCall.SEND, mac + b"x") == -NOT_INIT
    station.handle_call(0.0, ON)
    assert call(EspNowCall.SEND, mac + b"x") == -NOT_FOUND
    assert call(EspNowCall.ADD_PEER, mac) == 0
    assert call(EspNowCall.ADD_PEER, mac) == -EXIST
    assert call(EspNowCall.SEND, mac + bytes(MAX_PACKET_BYTES + 1)) == -ARG
    answers = [call(EspNowCall.SEND, mac + bytes(MAX_PACKET_BYTES)) for _ in range(8)]
    assert answers[0] == 0 and answers[-1] == -NO_MEM
    more = [call(EspNowCall.ADD_PEER, bytes([2, 0, 0, 0, 1, k])) for k in range(MAX_PEERS)]
    assert more[-2:] == [0, -FULL]


def test_a_packet_that_the_small_buffer_does_not_hold_is_acknowledged_and_dropped():
    radio_medium = RadioMedium()
    sender, receiver = EspNow(radio_medium, b"\2\0\0\0\0\1"), EspNow(radio_medium, b"\2\0\0\0\0\2")
    sender.handle_call(0.0, ON)
    receiver.handle_call(0.0, ON)
    sender.handle_call(0.0, bytes([EspNowCall.ADD_PEER]) + receiver.mac)
    for k in range(3):
        sender.handle_call(k * 1e7, bytes([EspNowCall.SEND]) + receiver.mac + bytes(200))
        radio_medium.run_in_order(sender, (k + 1) * 1e7, lambda: None)
    stats = [
        np.frombuffer(one.handle_call(9e7, bytes([EspNowCall.STATS]))[1], "<u4") for one in (sender, receiver)
    ]
    assert list(stats[0]) == [3, 3, 0, 0, 0]
    assert list(stats[1]) == [0, 0, 0, 2, 1]


def test_the_real_micropython_runs_it():
    recorded = ride(PacketFaults(loss=0.2), link="espnow", ids=(1,), interpreter="micropython", seconds=2.0)
    matches = match_samples(recorded.sent[1], recorded.truths[1])
    assert np.all(np.diff(matches[:, 0]) == 1) and len(matches) >= len(recorded.truths[1].t) - 32
    assert count_missing_frames(recorded.sent[1]) == 0
