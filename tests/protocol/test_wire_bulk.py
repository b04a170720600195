"""The vectorised decoder is the streaming one, only quicker."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from wire_strategies import dirty, drive, message, message_frames, portions

from hubodo.ingest.node import bulk
from hubodo.ingest.node.bulk import BulkDecoder, FrameGroup, fixed_fields, imu_samples
from hubowire import Frame, FrameDecoder, PayloadError, decode, encode, encode_frame
from hubowire.messages import Filter, Hello, ImuBatch, Mag


def frames_of(groups: list[FrameGroup]) -> list[Frame]:
    """The frames of some groups in the order they came."""
    rows = [
        (int(end), Frame(group.type_id, group.node, int(seq), payload.tobytes()))
        for group in groups
        for end, seq, payload in zip(group.end, group.seq, group.payload, strict=True)
    ]
    return [frame for _, frame in sorted(rows, key=lambda row: row[0])]


def counters(decoder: FrameDecoder | BulkDecoder) -> tuple:
    damage = decoder.damage
    causes = (damage.crc, damage.cobs, damage.short, damage.oversize, damage.cut, damage.bytes_lost)
    return (*causes, decoder.bytes_in, decoder.bytes_framed, decoder.idle_delimiters, decoder.pending)


@given(st.lists(message_frames(), max_size=40), st.integers(0, 2**32 - 1), st.data())
def test_frames_and_counters_equal_those_of_the_streaming_decoder_after_every_portion(
    some: list[Frame], seed: int, data: st.DataObject
):
    stream = dirty(b"".join(map(encode_frame, some)), np.random.default_rng(seed), share=0.02)
    one, many = FrameDecoder(), BulkDecoder()
    for part in data.draw(portions(stream)):
        assert frames_of(many.feed(part)) == one.feed(part)
        assert counters(many) == counters(one)
        if data.draw(st.booleans()):
            one.cut()
            many.cut()
            assert counters(many) == counters(one)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.01, 0.05])
@pytest.mark.parametrize("size", [50, 4096, 1 << 20])
def test_a_busy_dirty_link_gives_the_same_frames_and_counters(share: float, size: int, monkeypatch):
    # Small pieces put many piece edges into the stream.
    monkeypatch.setattr(bulk, "_PIECE", 30_000)
    print("seeds 11, 12")
    stream = dirty(drive(np.random.default_rng(11), 4000), np.random.default_rng(12), share)
    one, many = FrameDecoder(), BulkDecoder()
    for at in range(0, len(stream), size):
        part = stream[at : at + size]
        assert frames_of(many.feed(part)) == one.feed(part)
        assert counters(many) == counters(one)
    damage = many.damage
    if share >= 0.01:
        assert min(damage.crc, damage.cobs, damage.short, damage.oversize) > 0
    if share == 0:
        assert damage.frames == 0 and many.bytes_framed == len(stream)


def test_the_end_of_each_frame_is_where_its_delimiter_stands_in_the_stream():
    stream = b"\x05\x05\0" + b"".join(encode_frame(Frame(2, 1, n, bytes(n))) for n in range(40))
    decoder = BulkDecoder()
    groups = [group for at in range(0, len(stream), 33) for group in decoder.feed(stream[at : at + 33])]
    for group in groups:
        for end, payload in zip(group.end, group.payload, strict=True):
            length = len(payload) + 8
            assert FrameDecoder().feed(stream[end - length : end])[0].payload == payload.tobytes()
    assert sum(len(group.end) for group in groups) == 40


def reference_samples(frames: list[Frame]) -> tuple[dict[int, list[tuple]], int]:
    """Sample rows by node from one message at a time."""
    found: dict[int, list[tuple]] = {}
    malformed = 0
    for frame in frames:
        try:
            batch = decode(frame.type_id, frame.payload)
        except PayloadError:
            malformed += frame.type_id == ImuBatch.type_id
            continue
        if not isinstance(batch, ImuBatch):
            continue
        rows = found.setdefault(frame.node, [])
        for n, sample in enumerate(batch.samples):
            t_us = (batch.t_us + (n * batch.period_ns + 500) // 1000) % 2**30
            index = (batch.index + n) % 2**16
            rows.append((sample, t_us, batch.period_ns, index, batch.temperature_raw, batch.flags, frame.seq))
    return found, malformed


def rows_of(samples: bulk.ImuSamples) -> list[tuple]:
    columns = (
        samples.t_us,
        samples.period_ns,
        samples.index,
        samples.temperature_raw,
        samples.flags,
        samples.seq,
    )
    raw = [tuple(row) for row in samples.raw.tolist()]
    return list(zip(raw, *(column.tolist() for column in columns), strict=True))


def check_samples(frames: list[Frame], groups: list[FrameGroup]) -> None:
    expected, bad = reference_samples(frames)
    samples, malformed = imu_samples(groups)
    assert malformed == bad
    assert {node: rows_of(some) for node, some in samples.items() if len(some.raw)} == {
        node: rows for node, rows in expected.items() if rows
    }


def test_samples_equal_those_of_the_messages_one_by_one():
    print("seeds 21, 22")
    stream = dirty(drive(np.random.default_rng(21), 3000), np.random.default_rng(22), 0.001)
    frames, groups = FrameDecoder().feed(stream), BulkDecoder().feed(stream)
    check_samples(frames, groups)
    samples, malformed = imu_samples(groups)
    assert set(samples) == {1, 2} and malformed > 0
    assert samples[1].raw.dtype == np.int16 and samples[1].raw.shape[1] == 6


@given(st.lists(message(ImuBatch), max_size=20), st.binary(max_size=8))
def test_samples_of_any_batches_equal_those_one_by_one(batches: list[ImuBatch], newer: bytes):
    frames = [Frame(2, 1, n, (encode(batch) + newer)[:242]) for n, batch in enumerate(batches)]
    frames += [Frame(2, 1, 999, bytes(5))]
    check_samples(frames, BulkDecoder().feed(b"".join(map(encode_frame, frames))))


@given(st.lists(message(Filter), min_size=1, max_size=5), st.lists(message(Mag), min_size=1, max_size=5))
def test_fixed_fields_equal_those_of_the_messages(filters: list[Filter], mags: list[Mag]):
    frames = [Frame(m.type_id, 1, n, encode(m)) for n, m in enumerate([*filters, *mags])]
    groups = {group.type_id: group for group in BulkDecoder().feed(b"".join(map(encode_frame, frames)))}
    rows = fixed_fields(Filter, groups[Filter.type_id])
    assert rows["bias_q12"].tolist() == [list(m.bias_q12) for m in filters]
    assert rows["samples"].tolist() == [m.samples for m in filters]
    rows = fixed_fields(Mag, groups[Mag.type_id])
    assert rows["t_us"].tolist() == [m.t_us for m in mags]
    with pytest.raises(ValueError, match="Hello: needs 51 bytes, 10 came"):
        fixed_fields(Hello, groups[Mag.type_id])
