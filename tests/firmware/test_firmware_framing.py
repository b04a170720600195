"""Framing of the node agrees with that of the host."""

import json
import random
from pathlib import Path

import framing
import native
import pytest
from hypothesis import given
from hypothesis import strategies as st
from outbox import Slot

import hubowire

ROOT = Path(__file__).parents[2]
CASES = [
    pytest.param(case, id=f"{path.stem}: {case['name']}")
    for path in sorted((ROOT / "protocol" / "vectors").glob("*.json"))
    for case in json.loads(path.read_text())
]
UNDAMAGED = [
    case
    for case in CASES
    if not (
        any(case.values[0]["damage"].values())
        or case.values[0]["idle_delimiters"]
        or case.values[0]["pending"]
    )
]
FRAMES = st.builds(
    hubowire.Frame,
    st.integers(0, 255),
    st.integers(0, 255),
    st.integers(0, 65535),
    st.binary(max_size=hubowire.MAX_PAYLOAD) | st.integers(0, hubowire.MAX_PAYLOAD).map(bytes),
)


def encode_on_node(frame):
    raw = Slot().raw
    raw[framing.BODY : framing.PAYLOAD] = bytes((frame.type_id, frame.node, frame.seq & 255, frame.seq >> 8))
    raw[framing.PAYLOAD : framing.PAYLOAD + len(frame.payload)] = frame.payload
    end = framing.seal(raw, framing.PAYLOAD + len(frame.payload))
    return bytes(raw[framing.START : end])


def decode_on_node(stream):
    reader = framing.FrameReader()
    frames = []
    for byte in stream:
        if reader.feed(byte):
            payload = bytes(reader.raw[framing.PAYLOAD : framing.PAYLOAD + reader.size])
            frames.append(hubowire.Frame(reader.type_id, reader.node, reader.seq, payload))
    return frames, reader.damaged


def frames_of(case):
    return [
        hubowire.Frame(f["type"], f["node"], f["seq"], bytes.fromhex(f["payload"])) for f in case["frames"]
    ]


@pytest.mark.parametrize("case", CASES)
def test_the_node_decodes_every_vector_like_the_host(case):
    # A delimiter ends an open frame of the vector, so that both sides count it.
    stream = bytes.fromhex(case["stream"]) + b"\0"
    host = hubowire.FrameDecoder()
    host.feed(stream)
    frames, damaged = decode_on_node(stream)
    assert frames[: len(case["frames"])] == frames_of(case)
    assert damaged == host.damage.frames


@pytest.mark.parametrize("case", UNDAMAGED)
def test_the_node_encodes_every_undamaged_vector_to_the_same_bytes(case):
    assert b"".join(map(encode_on_node, frames_of(case))).hex() == case["stream"]


@given(FRAMES)
def test_node_and_host_encode_frames_to_the_same_bytes(frame):
    assert encode_on_node(frame) == hubowire.encode_frame(frame)


@given(st.lists(FRAMES, max_size=5))
def test_the_node_decodes_frames_of_the_host(frames):
    assert decode_on_node(b"".join(map(hubowire.encode_frame, frames))) == (frames, 0)


@given(st.binary(max_size=2000))
def test_random_bytes_give_the_same_frames_as_on_the_host_and_no_exception(noise):
    decoder = hubowire.FrameDecoder()
    assert decode_on_node(noise)[0] == decoder.feed(noise)


@given(FRAMES, st.integers(0, 10**6))
def test_a_frame_with_a_wrong_bit_is_never_accepted(frame, at):
    stream = bytearray(hubowire.encode_frame(frame))
    bit = at % (8 * (len(stream) - 1))
    stream[bit // 8] ^= 1 << bit % 8
    frames, _ = decode_on_node(stream)
    assert frame not in frames


def test_the_native_crc_equals_the_plain_one():
    fast, rng = native.load(), random.Random(4)
    for _ in range(200):
        data = rng.randbytes(rng.randrange(1, 250))
        start = rng.randrange(len(data))
        assert fast.crc16(data, start, len(data)) == framing.crc16_plain(data, start, len(data))


@given(st.lists(st.sampled_from((0, 0, 1, 255)) | st.integers(0, 255), max_size=hubowire.MAX_PAYLOAD))
def test_the_native_encoder_gives_the_same_bytes_as_the_plain_one(body):
    end = framing.PAYLOAD + len(body)
    ours, theirs = Slot().raw, Slot().raw
    ours[framing.PAYLOAD : end] = theirs[framing.PAYLOAD : end] = bytes(body)
    assert native.load().seal(ours, end) == framing.seal_plain(theirs, end)
    assert ours == theirs


def test_the_crc_of_123456789_is_the_catalogue_value():
    assert framing.crc16_plain(b"123456789", 0, 9) == 0x29B1
