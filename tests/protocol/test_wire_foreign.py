"""A decoder in C, written from the README alone, agrees with all vectors and with the host on damage."""

import json
import os
import random
import shutil
import subprocess
from pathlib import Path

import pytest
from test_wire_vectors import FILES

from hubodo.log.hubodo_messages import decode_bytes_message
from hubodo.log.log_writer import LogWriter
from hubodo.log.recording_reader import open_log
from hubowire import FrameDecoder

SOURCE = Path(__file__).with_name("foreign_decoder.c")
README = Path(__file__).resolve().parents[2] / "protocol" / "README.md"
VECTORS = [(stem, vector) for stem, some in FILES.items() for vector in some]
ORDINARY = [vector["stream"] for _, vector in VECTORS if not vector["pending"]]


@pytest.fixture(scope="module")
def decoder(tmp_path_factory):
    """Return a function that runs the decoder: streams and portion size -> its result for each stream."""
    compiler = shutil.which("cc")
    if compiler is None:
        if os.environ.get("CI"):
            pytest.fail("no C compiler: install cc", pytrace=False)
        pytest.skip("no C compiler (cc) to build the foreign decoder with")
    program = tmp_path_factory.mktemp("c") / "foreign_decoder"
    words = [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", "-o", program, SOURCE]
    subprocess.run(words, check=True)

    def run(streams: list[str], portion: int) -> list[dict]:
        lines = "".join(f"{stream}\n" for stream in streams)
        done = subprocess.run(
            [program, README, str(portion)], input=lines, capture_output=True, text=True, check=True
        )
        return [json.loads(line) for line in done.stdout.splitlines()]

    return run


@pytest.mark.parametrize("portion", [1, 7, 10_000])
def test_every_vector_is_decoded_as_it_says(decoder, portion):
    answers = decoder([vector["stream"] for _, vector in VECTORS], portion)
    for (stem, vector), answer in zip(VECTORS, answers, strict=True):
        wanted = {key: value for key, value in vector.items() if key not in ("name", "origin", "stream")}
        assert answer == wanted, f"{stem}: {vector['name']}"


def test_vectors_in_a_row_and_damaged_streams_are_given_up_at_the_same_bytes_as_by_the_host(decoder):
    rng = random.Random(20)
    streams = []
    for _ in range(60):
        data = bytearray(bytes.fromhex("".join(rng.sample(ORDINARY, 12))))
        for _ in range(rng.randrange(20)):
            at = rng.randrange(len(data))
            data[at : at + rng.randrange(3)] = rng.randbytes(rng.randrange(3))
        streams.append(data.hex())
    for stream, answer in zip(streams, decoder(streams, 13), strict=True):
        ours = FrameDecoder()
        frames = ours.feed(bytes.fromhex(stream))
        decoded = [
            (row["type"], row["node"], row["seq"], bytes.fromhex(row["payload"])) for row in answer["frames"]
        ]
        assert decoded == [(frame.type_id, frame.node, frame.seq, frame.payload) for frame in frames]
        counts = {"crc": ours.damage.crc, "cobs": ours.damage.cobs, "oversize": ours.damage.oversize}
        assert counts.items() <= answer["damage"].items()
        assert answer["damage"]["bytes_lost"] == ours.damage.bytes_lost
        assert (answer["idle_delimiters"], answer["pending"]) == (ours.idle_delimiters, ours.pending_bytes)


def test_frames_in_a_log_follow_a_header_of_sixteen_bytes(decoder, tmp_path):
    frames = [bytes.fromhex(vector["stream"]) for stem, vector in VECTORS if stem in ("hello", "imu_batch")]
    with LogWriter(tmp_path / "log.mcap") as log:
        for i, frame in enumerate(frames):
            log.write_raw_frame("usb0", i, frame)
    with open_log(tmp_path / "log.mcap") as log:
        messages = [m.data for m in log.messages()]
    assert (
        [decode_bytes_message("cdr", data) for data in messages] == [data[16:] for data in messages] == frames
    )
    (answer,) = decoder([b"".join(data[16:] for data in messages).hex()], 50)
    assert len(answer["frames"]) == len(frames)
