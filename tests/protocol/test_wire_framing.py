"""COBS, CRC and the streaming decoder: published values, properties, accounting of every byte."""

import crcmod.predefined
import numpy as np
import pytest
import second_encoder
from cobs import cobs
from hypothesis import example, given
from hypothesis import strategies as st
from wire_strategies import dirty, drive, frames, portions

from hubowire import MAX_FRAME, MAX_PAYLOAD, OVERHEAD, Frame, FrameDecoder, encode_frame
from hubowire.framing import cobs_decode, cobs_encode, crc16

# The examples of the article "Consistent Overhead Byte Stuffing" in Wikipedia, without the delimiter.
COBS_EXAMPLES = [
    ("00", "0101"),
    ("0000", "010101"),
    ("001100", "01021101"),
    ("11220033", "0311220233"),
    ("11223344", "0511223344"),
    ("11000000", "0211010101"),
    ("", "01"),
]
crc_of_crcmod = crcmod.predefined.mkPredefinedCrcFun("crc-ccitt-false")
bodies = st.binary(max_size=253) | st.lists(st.sampled_from([0, 0, 1, 255]), max_size=253).map(bytes)


@pytest.mark.parametrize(("plain", "stuffed"), COBS_EXAMPLES)
def test_cobs_equals_the_published_examples_in_both_directions(plain: str, stuffed: str):
    assert cobs_encode(bytes.fromhex(plain)).hex() == stuffed
    assert cobs_decode(bytes.fromhex(stuffed)) == bytes.fromhex(plain)


def test_crc_has_the_check_value_of_the_catalogue():
    assert crc16(b"123456789") == 0x29B1


@given(bodies)
def test_cobs_equals_the_pypi_package_and_leaves_no_zero(body: bytes):
    stuffed = cobs_encode(body)
    assert stuffed == cobs.encode(body) == second_encoder.cobs(body)
    assert 0 not in stuffed and len(stuffed) == len(body) + 1
    assert cobs_decode(stuffed) == body


@given(st.binary(max_size=254))
@example(b"\x01\x00")
@example(b"\xff" + bytes([1]) * 253)
def test_unstuffing_accepts_exactly_what_the_pypi_package_accepts(stuffed: bytes):
    try:
        expected = cobs.decode(stuffed)
    except cobs.DecodeError:
        expected = None
    # The package returns an empty body for no bytes at all; no frame is empty, so the decoder never asks
    # that.
    assert stuffed == b"" or cobs_decode(stuffed) == expected


@given(st.binary(max_size=300))
def test_crc_equals_crcmods_and_a_bitwise_one(data: bytes):
    assert crc16(data) == crc_of_crcmod(data) == second_encoder.crc(data)


@given(frames)
def test_frames_round_trip_and_equal_the_second_encoder(frame: Frame):
    stream = encode_frame(frame)
    assert stream == second_encoder.frame(frame.type_id, frame.node, frame.seq, frame.payload)
    assert len(stream) == len(frame.payload) + OVERHEAD <= MAX_FRAME
    assert stream.index(0) == len(stream) - 1
    decoder = FrameDecoder()
    assert decoder.feed(stream) == [frame]
    assert decoder.damage.frames == 0


def test_a_payload_that_does_not_fit_is_refused_with_both_sizes():
    with pytest.raises(ValueError, match=f"{MAX_PAYLOAD + 1} bytes: at most {MAX_PAYLOAD}"):
        encode_frame(Frame(1, 1, 1, bytes(MAX_PAYLOAD + 1)))


def test_the_overhead_is_at_most_nine_bytes():
    assert OVERHEAD <= 9 and MAX_FRAME == 250


@given(frames)
def test_a_frame_cut_at_any_byte_is_lost_and_the_next_one_is_not(frame: Frame):
    stream = encode_frame(frame)
    follower = Frame(0x42, 1, 2, b"")
    for end in range(len(stream) - 1):
        decoder = FrameDecoder()
        assert decoder.feed(stream[:end] + b"\0" + encode_frame(follower)) == [follower]
        assert decoder.damage.frames == (1 if end else 0)
        assert decoder.damage.bytes_lost == (end + 1 if end else 0)


@given(frames, frames, st.data())
def test_a_splice_of_two_frames_is_never_delivered_as_either(one: Frame, other: Frame, data: st.DataObject):
    head, tail = encode_frame(one), encode_frame(other)
    cut = data.draw(st.integers(1, len(head) - 1))
    skip = data.draw(st.integers(1, len(tail) - 1))
    spliced = head[:cut] + tail[skip:]
    if spliced in (head, tail):
        return
    for frame in FrameDecoder().feed(spliced):
        assert frame not in (one, other)


@given(st.lists(frames, max_size=6), st.integers(0, 2**32 - 1), st.data())
def test_portions_do_not_matter_and_every_byte_is_accounted_for(some: list, seed: int, data: st.DataObject):
    stream = dirty(b"".join(map(encode_frame, some)), np.random.default_rng(seed), share=0.05)
    whole, split, single = FrameDecoder(), FrameDecoder(), FrameDecoder()
    expected = whole.feed(stream)
    assert [f for part in data.draw(portions(stream)) for f in split.feed(part)] == expected
    assert [f for byte in stream for f in single.feed(bytes([byte]))] == expected
    for decoder in (whole, split, single):
        assert decoder.damage == whole.damage
        assert decoder.bytes_in == len(stream)
        assert len(stream) == (
            decoder.bytes_framed + decoder.damage.bytes_lost + decoder.idle_delimiters + decoder.pending_bytes
        )
        assert decoder.bytes_framed == sum(len(frame.payload) + OVERHEAD for frame in expected)


@pytest.mark.parametrize("noise", [1, 100, 249, 250, 251, 1000, 100_000])
def test_the_frame_after_any_noise_and_one_delimiter_is_delivered(noise: int):
    follower = Frame(0x42, 1, 2, b"")
    decoder = FrameDecoder()
    assert decoder.feed(b"\x55" * noise + b"\0" + encode_frame(follower)) == [follower]
    assert decoder.damage.frames == 1
    assert decoder.damage.bytes_lost == noise + 1


def test_after_a_cut_the_first_complete_frame_is_delivered_and_the_partial_one_counted():
    frame = Frame(0x42, 1, 2, b"")
    decoder = FrameDecoder()
    decoder.feed(encode_frame(frame)[:5])
    decoder.interrupt()
    assert decoder.feed(encode_frame(frame)) == [frame]
    assert (decoder.damage.cut, decoder.damage.bytes_lost, decoder.pending_bytes) == (1, 5, 0)
    decoder.feed(b"\x55" * 400)
    decoder.interrupt()
    assert decoder.feed(encode_frame(frame)) == [frame]
    assert (decoder.damage.cut, decoder.damage.oversize) == (1, 1)


def test_stuffed_bytes_from_a_damaged_log_are_counted_and_not_walked_for_ever():
    decoder = FrameDecoder()
    assert decoder.decode_frame(b"\x03\x00\x00\x00") is None
    assert decoder.decode_frame(b"\x05" + bytes(300)) is None
    assert decoder.damage.cobs == 2


def test_raw_frames_split_off_for_the_log_decode_to_the_same_frames():
    stream = dirty(drive(np.random.default_rng(7), 300), np.random.default_rng(8))
    raw = FrameDecoder().split_frames(stream)
    replayed = FrameDecoder()
    assert [f for part in raw if (f := replayed.decode_frame(part))] == FrameDecoder().feed(stream)
