"""Every stored vector against both host decoders and an independent encoder."""

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import second_encoder

from hubodo.ingest.node.bulk import BulkDecoder
from hubowire import MAX_FRAME, MESSAGES, Frame, FrameDecoder, PayloadError, decode, encode, encode_frame
from hubowire.messages import upper_snake

FOLDER = Path(__file__).resolve().parents[2] / "protocol" / "vectors"
FILES = {file.stem: json.loads(file.read_text()) for file in sorted(FOLDER.glob("*.json"))}
VECTORS = [
    pytest.param(vector, id=f"{stem}: {vector['name']}") for stem, some in FILES.items() for vector in some
]


def expected_frames(vector: dict) -> list[Frame]:
    return [
        Frame(row["type"], row["node"], row["seq"], bytes.fromhex(row["payload"])) for row in vector["frames"]
    ]


def blocks(vector: dict, size: int) -> Iterator[bytes]:
    """Yield the stream of a vector in blocks of `size` bytes."""
    stream = bytes.fromhex(vector["stream"])
    return (stream[at : at + size] for at in range(0, len(stream), size))


def assert_damage_is_that_of(vector: dict, decoder: FrameDecoder | BulkDecoder) -> None:
    assert dataclasses.asdict(decoder.damage) == vector["damage"]
    assert (decoder.idle_delimiters, decoder.pending_bytes) == (vector["idle_delimiters"], vector["pending"])


def one_frame(vector: dict) -> bool:
    return len(vector["frames"]) == 1 and not vector["idle_delimiters"] and not vector["pending"]


def as_json(message: object) -> dict:
    values = dataclasses.asdict(message)
    return json.loads(json.dumps({k: v.hex() if isinstance(v, bytes) else v for k, v in values.items()}))


def test_every_message_has_a_typical_vector_and_extremes():
    for message in MESSAGES:
        vectors = FILES[upper_snake(message.__name__).lower()]
        assert len(vectors) >= 2
        assert {row["message"] for vector in vectors for row in vector["frames"]} == {message.__name__}


def test_every_cause_of_damage_has_a_vector():
    causes = {
        cause for some in FILES.values() for vector in some for cause, n in vector["damage"].items() if n
    }
    assert causes >= {"crc", "cobs", "short", "oversize", "bytes_lost"}


@pytest.mark.parametrize("vector", VECTORS)
def test_the_streaming_decoder_returns_the_frames_of_the_vector_for_blocks_of_any_size(vector: dict):
    for size in (1, 2, 7, 10_000):
        decoder = FrameDecoder()
        frames = [frame for block in blocks(vector, size) for frame in decoder.feed(block)]
        assert frames == expected_frames(vector), size
        assert_damage_is_that_of(vector, decoder)


@pytest.mark.parametrize("vector", VECTORS)
def test_the_bulk_decoder_returns_the_frames_of_the_vector_for_blocks_of_any_size(vector: dict):
    for size in (1, 10_000):
        decoder = BulkDecoder()
        received = [
            (int(end), Frame(group.type_id, group.node, int(seq), payload.tobytes()))
            for block in blocks(vector, size)
            for group in decoder.feed(block)
            for end, seq, payload in zip(group.end_offset, group.seq, group.payload, strict=True)
        ]
        frames = [frame for _, frame in sorted(received, key=lambda row: row[0])]
        assert frames == expected_frames(vector), size
        assert_damage_is_that_of(vector, decoder)


@pytest.mark.parametrize("vector", VECTORS)
def test_payloads_decode_to_the_values_of_the_vector(vector: dict):
    for row in vector["frames"]:
        payload = bytes.fromhex(row["payload"])
        if row.get("malformed"):
            with pytest.raises(PayloadError):
                decode(row["type"], payload)
            continue
        message = decode(row["type"], payload)
        if row["message"] is None:
            assert message is None
        else:
            assert type(message).__name__ == row["message"]
            assert as_json(message) == row["values"]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda kind: kind.__name__)
def test_a_second_encoder_written_apart_makes_the_same_bytes_from_the_values(message: type):
    for vector in FILES[upper_snake(message.__name__).lower()]:
        (row,) = vector["frames"]
        payload = second_encoder.payload(row["message"], row["values"])
        assert payload.hex() == row["payload"]
        stream = second_encoder.frame(row["type"], row["node"], row["seq"], payload)
        assert stream.hex() == vector["stream"]
        decoded_message = decode(row["type"], payload)
        assert encode(decoded_message) == payload
        assert encode_frame(Frame(row["type"], row["node"], row["seq"], payload)) == stream


def test_no_single_bit_error_of_any_vector_frame_yields_a_frame_and_the_neighbours_survive():
    before = encode_frame(Frame(0x42, 9, 1, b""))
    after = encode_frame(Frame(0x42, 9, 2, b"after"))
    first, last = FrameDecoder().feed(before)[0], FrameDecoder().feed(after)[0]
    streams = {
        f"{stem}: {vector['name']}": bytes.fromhex(vector["stream"])
        for stem, some in FILES.items()
        for vector in some
        if not stem.startswith("bad_") and one_frame(vector)
    }
    assert max(map(len, streams.values())) == MAX_FRAME
    for name, stream in streams.items():
        for bit in range(8 * len(stream)):
            broken = bytearray(stream)
            broken[bit // 8] ^= 1 << bit % 8
            decoder = FrameDecoder()
            # A lost delimiter joins the frame to the next one; a second valid frame shows the recovery.
            frames = decoder.feed(before + broken + after + after)
            survivors = [last] if bit // 8 == len(stream) - 1 else [last, last]
            assert frames == [first, *survivors], f"{name}: bit {bit}"
            assert decoder.damage.frames >= 1
