"""The vectorised decoder returns the frames of the streaming decoder."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from wire_strategies import dirty, drive, message, message_frames, portions

from hubodo.ingest.node import bulk
from hubodo.ingest.node.bulk import BulkDecoder, FrameGroup
from hubodo.ingest.node.node_frames import group_by_node
from hubowire import Frame, FrameDecoder, PayloadError, decode, encode, encode_frame
from hubowire.messages import ImuBatch
from repetitions import each_value_first


def frames_of(groups: list[FrameGroup]) -> list[Frame]:
    """Return the frames of some groups in the order of arrival."""
    rows = [
        (int(end), Frame(group.type_id, group.node, int(seq), payload.tobytes()))
        for group in groups
        for end, seq, payload in zip(group.end_offset, group.seq, group.payload, strict=True)
    ]
    return [frame for _, frame in sorted(rows, key=lambda row: row[0])]


def counters(decoder: FrameDecoder | BulkDecoder) -> tuple:
    damage = decoder.damage
    causes = (damage.crc, damage.cobs, damage.short, damage.oversize, damage.cut, damage.bytes_lost)
    return (*causes, decoder.bytes_in, decoder.bytes_framed, decoder.idle_delimiters, decoder.pending_bytes)


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
            one.interrupt()
            many.interrupt()
            assert counters(many) == counters(one)


@pytest.mark.parametrize(("share", "size"), each_value_first((0.01, 0.0, 0.001, 0.05), (50, 4096, 1 << 20)))
def test_a_busy_dirty_link_gives_the_same_frames_and_counters(
    share: float, size: int, monkeypatch: pytest.MonkeyPatch
):
    # Small pieces put many piece edges into the stream.
    monkeypatch.setattr(bulk, "_MAX_PIECE_BYTES", 30_000)
    print("seeds 11, 12")
    stream = dirty(
        drive(np.random.default_rng(11), 1500 if size == 50 else 4000), np.random.default_rng(12), share
    )
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


def test_the_end_of_each_frame_is_the_position_of_its_delimiter():
    stream = b"\x05\x05\0" + b"".join(encode_frame(Frame(2, 1, n, bytes(n))) for n in range(40))
    decoder = BulkDecoder()
    groups = [group for at in range(0, len(stream), 33) for group in decoder.feed(stream[at : at + 33])]
    for group in groups:
        for end, payload in zip(group.end_offset, group.payload, strict=True):
            length = len(payload) + 8
            assert FrameDecoder().feed(stream[end - length : end])[0].payload == payload.tobytes()
    assert sum(len(group.end_offset) for group in groups) == 40


def no_times(end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return end, np.zeros_like(end)


def is_sound_batch(frame: Frame) -> bool:
    """Return True for a complete batch with at least one sample."""
    try:
        batch = decode(frame.type_id, frame.payload)
    except PayloadError:
        return False
    return isinstance(batch, ImuBatch) and len(batch.samples) > 0


def check_by_node(frames: list[Frame], groups: list[FrameGroup]) -> None:
    """The batches and other frames of each node are all frames, in their order."""
    by_node = group_by_node(groups, no_times)
    assert set(by_node) == {frame.node for frame in frames}
    for node, some in by_node.items():
        own = [frame for frame in frames if frame.node == node]
        batches = [decode(frame.type_id, frame.payload) for frame in own if is_sound_batch(frame)]
        assert [frame.seq for frame in own if is_sound_batch(frame)] == some.batches.seq.tolist()
        again = [some.batch_frame(k) for k in range(len(some.batches))]
        assert [decode(frame.type_id, frame.payload) for frame in again] == batches
        assert [other.frame for other in some.others] == [f for f in own if not is_sound_batch(f)]
        ends = [other.end_offset for other in some.others]
        assert ends == sorted(ends) and bool((np.diff(some.batches.end_offset) > 0).all())


def test_batches_and_other_frames_of_each_node_are_those_of_the_messages():
    print("seeds 21, 22")
    stream = dirty(drive(np.random.default_rng(21), 3000), np.random.default_rng(22), 0.001)
    frames, groups = FrameDecoder().feed(stream), BulkDecoder().feed(stream)
    check_by_node(frames, groups)
    assert any(not is_sound_batch(f) for f in frames if f.type_id == ImuBatch.type_id)


@given(st.lists(message(ImuBatch), max_size=20), st.binary(max_size=8))
def test_any_batches_are_those_of_the_messages(batches: list[ImuBatch], newer: bytes):
    frames = [Frame(2, 1, n, (encode(batch) + newer)[:242]) for n, batch in enumerate(batches)]
    frames += [Frame(2, 1, 999, bytes(5))]
    check_by_node(frames, BulkDecoder().feed(b"".join(map(encode_frame, frames))))
