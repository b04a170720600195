"""Node decoder: scales, exact losses, causes of gaps, detection of restarts."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hubodo.ingest.node.decoder import NodeDecoder
from hubodo.ingest.node.gaps import (
    CHIP_OVERRUN,
    DAMAGED_BYTES,
    DROPPED_BY_NODE,
    LINK_DOWN,
    LOST_IN_TRANSIT,
    NODE_RESTARTED,
    LinkCounts,
)
from hubodo.ingest.node.outputs import (
    BiasFilterReport,
    HealthReceived,
    HelloReceived,
    MagSample,
    TimeReplyReceived,
    WireMismatchReport,
)
from hubodo.log.records import ImuBlock
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubowire import FINGERPRINT, Frame, encode
from hubowire.messages import BatchFlag, Filter, Health, Hello, HighG, ImuBatch, Mag, TimeReply

T0 = 1_700_000_000 * NS_PER_S
HELLO = Hello(
    FINGERPRINT, (1, 2, 3), b"serial01", 77, 1, 1, 208_000, 2000, 16,
    70_000_000, 488_000, 62_500, 25_000_000, 14_614_000, 8, 0, 40, ((0x6B, 0x69, 1),),
)  # fmt: skip
PERIOD_NS = 4_807_692
BATCH = 8
QUIET = LinkCounts()
HEALTH = Health(0, 3700, 0, 0, 0, 0, 0, 0, 0, 1, 900, 1, 50_000, 40)


class Talker:
    """A node that numbers frames and samples."""

    def __init__(self, hello=HELLO, index=0, start_us=0):
        self.hello_message, self.index, self.start_us = hello, index, start_us
        self.seqs = {}

    def frame(self, message):
        seq = self.seqs.get(message.type_id, 0)
        self.seqs[message.type_id] = (seq + 1) & 0xFFFF
        return Frame(message.type_id, 1, seq, encode(message))

    def hello(self):
        return self.frame(self.hello_message)

    def host_ns(self):
        return T0 + self.index * PERIOD_NS

    def batch(self, flags=0, count=BATCH):
        t_us = (self.start_us + self.index * PERIOD_NS // 1000) % (1 << 30)
        rows = tuple((self.index % 1000 + k, 0, -5, 0, 0, 2049) for k in range(count))
        message = ImuBatch(t_us, PERIOD_NS, self.index & 0xFFFF, 160, flags, rows)
        self.index += count
        return self.frame(message)

    def lose(self, batches):
        for _ in range(batches):
            self.batch()


def blocks(outputs):
    return [item for item in outputs if isinstance(item, ImuBlock)]


def gaps(outputs):
    return [item for item in outputs if isinstance(item, Event) and item.kind == "gap"]


def started(**kwargs):
    talker, decoder = Talker(**kwargs), NodeDecoder("left")
    list(decoder.decode_frame(talker.hello(), talker.host_ns(), QUIET))
    return talker, decoder


def feed(decoder, talker, count=1, link=QUIET, **kwargs):
    out = []
    for _ in range(count):
        frame = talker.batch(**kwargs)
        out += decoder.decode_frame(frame, talker.host_ns(), link)
    return out


def test_samples_have_si_units_and_device_times():
    talker, decoder = started(start_us=1_000)
    (block,) = blocks(feed(decoder, talker))
    assert block.gyro.shape == (BATCH, 3)
    np.testing.assert_allclose(block.gyro[3, 0], math.radians(3 * 0.07), rtol=1e-12)
    np.testing.assert_allclose(block.gyro[3, 2], math.radians(-5 * 0.07), rtol=1e-12)
    np.testing.assert_allclose(block.accel[0], [0, 0, 2049 * 0.488e-3 * 9.80665], rtol=1e-12)
    assert block.temperature == pytest.approx(35.0)
    np.testing.assert_array_equal(block.device_ns, 1_000_000 + PERIOD_NS * np.arange(BATCH))


def test_frames_before_the_first_hello_are_queued_and_decoded_when_it_arrives():
    talker, decoder = Talker(), NodeDecoder("left")
    assert feed(decoder, talker, 5) == []
    assert decoder.wants_hello
    out = list(decoder.decode_frame(talker.hello(), talker.host_ns(), QUIET))
    assert isinstance(out[0], HelloReceived)
    assert len(blocks(out)) == 5
    assert gaps(out) == []
    assert not decoder.wants_hello


def test_the_number_of_frames_queued_without_hello_is_bounded():
    talker, decoder = Talker(), NodeDecoder("left")
    feed(decoder, talker, 2100)
    out = list(decoder.decode_frame(talker.hello(), talker.host_ns(), QUIET))
    assert len(blocks(out)) == 2048
    assert decoder.counts.frames_undecoded == 2100 - 2048


@pytest.mark.parametrize("size", [1, 20])
def test_a_hello_that_is_cut_off_counts_as_one_frame_that_was_not_read(size):
    decoder, hello = NodeDecoder("left"), Talker().hello()
    assert list(decoder.decode_frame(replace(hello, payload=hello.payload[:size]), T0, QUIET)) == []
    assert decoder.counts.frames_undecoded == 1


@given(st.integers(1, 9000), st.integers(0, 65535))
def test_lost_samples_are_counted_exactly_across_wraps_of_both_counters(batches, index):
    talker, decoder = started(index=index)
    feed(decoder, talker)
    talker.index += batches * BATCH
    talker.seqs[ImuBatch.type_id] = (talker.seqs[ImuBatch.type_id] + batches) & 0xFFFF
    list(feed(decoder, talker))
    assert decoder.counts.samples_lost == batches * BATCH
    assert decoder.counts.frames_lost == batches


@pytest.mark.parametrize(
    ("link", "flags", "cause"),
    [
        (LinkCounts(damaged_frames=1), 0, DAMAGED_BYTES),
        (LinkCounts(disconnections=1), 0, LINK_DOWN),
        (LinkCounts(damaged_frames=3, disconnections=1), 0, LINK_DOWN),
        (QUIET, BatchFlag.FIFO_OVERRUN, CHIP_OVERRUN),
    ],
)
def test_a_gap_has_its_cause_at_once_if_link_or_flags_show_it(link, flags, cause):
    talker, decoder = started()
    feed(decoder, talker, 3)
    before_ns = talker.host_ns()
    talker.lose(2)
    (gap,) = gaps(feed(decoder, talker, link=link, flags=flags))
    assert gap.data["cause"] == cause
    assert gap.data["samples_lost"] == 2 * BATCH
    assert gap.data["frames_lost"] == 2
    assert gap.t_ns == before_ns
    assert gap.data["duration_s"] == pytest.approx((2 * BATCH + 1) * PERIOD_NS * 1e-9, abs=2e-6)
    assert "16 samples lost" in gap.text
    assert cause in gap.text


def test_the_same_damage_does_not_explain_a_later_gap():
    talker, decoder = started()
    damaged = LinkCounts(damaged_frames=1)
    feed(decoder, talker, link=damaged)
    feed(decoder, talker, link=damaged)
    talker.lose(1)
    out = feed(decoder, talker, link=damaged)
    assert gaps(out) == []
    assert [gap.data["cause"] for gap in gaps(decoder.close())] == [LOST_IN_TRANSIT]


@pytest.mark.parametrize(("dropped", "cause"), [(3, DROPPED_BY_NODE), (0, LOST_IN_TRANSIT)])
def test_an_unexplained_gap_waits_for_the_health_report(dropped, cause):
    talker, decoder = started()
    feed(decoder, talker, 2)
    talker.lose(3)
    assert gaps(feed(decoder, talker)) == []
    out = []
    for _ in range(2):
        frame = talker.frame(replace(HEALTH, frames_dropped=dropped))
        out += decoder.decode_frame(frame, talker.host_ns(), QUIET)
    assert [gap.data["cause"] for gap in gaps(out)] == [cause]
    assert sum(isinstance(item, HealthReceived) for item in out) == 2


def test_an_unexplained_gap_is_named_even_when_no_report_comes():
    talker, decoder = started()
    feed(decoder, talker)
    talker.lose(1)
    feed(decoder, talker)
    assert gaps(decoder.tick(talker.host_ns() + NS_PER_S)) == []
    assert [gap.data["cause"] for gap in gaps(decoder.tick(talker.host_ns() + 7 * NS_PER_S))] == [
        LOST_IN_TRANSIT
    ]


def test_a_restart_is_an_event_and_the_new_start_counts_from_zero():
    talker, decoder = started(start_us=900_000_000)
    feed(decoder, talker, 10)
    host = talker.host_ns()
    again = Talker(replace(HELLO, boot_id=78, reset_cause=3))
    out = list(decoder.decode_frame(again.hello(), host + NS_PER_S, QUIET))
    assert [item.kind for item in out if isinstance(item, Event)] == ["reset", "gap"]
    assert gaps(out)[0].data["cause"] == NODE_RESTARTED
    assert gaps(out)[0].data["samples_lost"] is None
    assert any(isinstance(item, HelloReceived) and item.restarted for item in out)
    assert "watchdog" in next(item.text for item in out if isinstance(item, Event))
    (block,) = blocks(decoder.decode_frame(again.batch(), host + 2 * NS_PER_S, QUIET))
    assert block.device_ns[0] == 0
    assert decoder.counts.samples_lost == 0


def test_a_restart_whose_hello_was_lost_is_suspected_and_settled_by_the_next_hello():
    talker, decoder = started(start_us=900_000_000)
    feed(decoder, talker, 10)
    host = talker.host_ns()
    again = Talker(replace(HELLO, boot_id=78))
    again.hello()
    out = list(decoder.decode_frame(again.batch(), host + NS_PER_S, QUIET))
    out += decoder.decode_frame(again.batch(), host + NS_PER_S, QUIET)
    assert out == []
    assert decoder.wants_hello
    out = list(decoder.decode_frame(again.hello(), host + 2 * NS_PER_S, QUIET))
    assert len(blocks(out)) == 2
    assert decoder.counts.restarts == 1


def test_a_pause_of_the_clocks_that_was_no_restart_loses_nothing():
    talker, decoder = started()
    feed(decoder, talker, 3)
    late = talker.host_ns() + 60 * NS_PER_S  # the host's process was stopped for a minute
    assert list(decoder.decode_frame(talker.batch(), late, QUIET)) == []
    out = list(decoder.decode_frame(talker.hello(), late, QUIET))
    assert len(blocks(out)) == 1
    assert decoder.counts.restarts == 0
    assert decoder.counts.samples == 4 * BATCH


def test_another_wire_version_is_refused_by_name_and_nothing_is_decoded():
    talker, decoder = Talker(replace(HELLO, fingerprint=0xDEADBEEF)), NodeDecoder("left")
    feed(decoder, talker, 2)
    (refused,) = decoder.decode_frame(talker.hello(), T0, QUIET)
    assert isinstance(refused, WireMismatchReport)
    for part in ("'left'", "deadbeef", "1.2.3", f"{FINGERPRINT:08x}", "flash"):
        assert part in refused.text
    assert list(decoder.decode_frame(talker.hello(), T0, QUIET)) == []  # reported once
    assert feed(decoder, talker) == []
    assert not decoder.wants_hello


def test_a_hello_of_another_version_may_be_shorter_or_longer_than_ours():
    for payload in (b"\xef\xbe\xad\xde\x01\x02\x03", b"\xef\xbe\xad\xde\x01\x02\x03" + bytes(200)):
        decoder = NodeDecoder("left")
        (refused,) = decoder.decode_frame(Frame(Hello.type_id, 1, 0, payload), T0, QUIET)
        assert "deadbeef" in refused.text


def test_a_reflashed_node_is_decoded_again():
    decoder = NodeDecoder("left")
    old = Talker(replace(HELLO, fingerprint=1))
    list(decoder.decode_frame(old.hello(), T0, QUIET))
    new = Talker(replace(HELLO, boot_id=5))
    list(decoder.decode_frame(new.hello(), T0 + NS_PER_S, QUIET))
    assert len(blocks(feed(decoder, new))) == 1


def test_late_datagrams_are_counted_and_do_not_turn_time_back():
    talker, decoder = Talker(), NodeDecoder("left", datagrams=True)
    list(decoder.decode_frame(talker.hello(), T0, QUIET))
    one, two, three = talker.batch(), talker.batch(), talker.batch()
    out = []
    for frame in (one, three, two):
        out += decoder.decode_frame(frame, talker.host_ns(), QUIET)
    assert len(blocks(out)) == 2
    assert decoder.counts.frames_late == 1
    assert not decoder.wants_hello


def test_small_messages_are_scaled_and_unwrapped():
    talker, decoder = started()
    out = list(decoder.decode_frame(talker.frame(Mag(1000, (100, -200, 300))), T0, QUIET))
    assert isinstance(out[0], MagSample)
    assert out[0].field == pytest.approx((1.4614e-6, -2.9228e-6, 4.3842e-6))
    samples = ((100, -200, 20), (101, -201, 21))
    out = list(decoder.decode_frame(talker.frame(HighG(9000, 2_500_000, 49_000_000, samples)), T0, QUIET))
    assert out[0].device_ns.tolist() == [6_500_000, 9_000_000]
    assert out[0].accel[1] == pytest.approx(np.array(samples[1]) * 0.049 * 9.80665)
    out = list(decoder.decode_frame(talker.frame(TimeReply(b"12345678", 5, 9)), T0, QUIET))
    assert isinstance(out[0], TimeReplyReceived)


def test_a_worsening_report_of_the_node_is_an_event():
    talker, decoder = started()
    list(decoder.decode_frame(talker.frame(HEALTH), T0, QUIET))
    out = list(
        decoder.decode_frame(talker.frame(replace(HEALTH, i2c_errors=2, faults=4)), T0 + NS_PER_S, QUIET)
    )
    (event,) = [item for item in out if isinstance(item, Event)]
    assert event.kind == "health"
    assert "bus stuck" in event.text
    assert "i2c errors +2" in event.text
    again = decoder.decode_frame(
        talker.frame(replace(HEALTH, i2c_errors=2, faults=4)), T0 + 2 * NS_PER_S, QUIET
    )
    assert not any(isinstance(item, Event) for item in again)


@given(st.integers(0, 255), st.binary(max_size=80), st.integers(0, 65535))
def test_no_payload_makes_it_raise(type_id, payload, seq):
    _, decoder = started()
    list(decoder.decode_frame(Frame(type_id, 1, seq, payload), T0, QUIET))
    list(decoder.close())


def test_the_nodes_own_bias_is_given_in_si_units_at_its_device_time():
    talker, decoder = started()
    step = 0.07 * math.pi / 180
    sent = Filter(5_000, 2, 3, 2000, (512, -256, 0), (4096, -2048, 1), (256, 1024, 0), (41, 0, 4096))
    (output,) = decoder.decode_frame(talker.frame(sent), T0 + 7_000_000, QUIET)
    assert isinstance(output, BiasFilterReport)
    assert (output.state, output.samples, output.saturations, output.device_ns) == (2, 2000, 3, 5_000_000)
    np.testing.assert_allclose(output.rate, (2 * step, -step, 0), rtol=1e-12)
    np.testing.assert_allclose(output.bias, (step, -step / 2, step / 4096), rtol=1e-12)
    np.testing.assert_allclose(output.noise, (step, 2 * step, 0), rtol=1e-12)
    np.testing.assert_allclose(output.bias_sigma, (step * 41 / 4096, math.nan, step), rtol=1e-12)


def test_a_filter_report_of_a_node_without_an_imu_is_ignored():
    talker, decoder = started(hello=replace(HELLO, gyro_lsb_ndps=0))
    sent = Filter(5_000, 0, 0, 0, (0, 0, 0), (0, 0, 0), (0, 0, 0), (0, 0, 0))
    assert list(decoder.decode_frame(talker.frame(sent), T0 + 7_000_000, QUIET)) == []
