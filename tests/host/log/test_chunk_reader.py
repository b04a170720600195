"""Messages of a chunk: those that its index announces are those found one by one, or it is not believed."""

import os

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from hubodo.log.chunk_reader import parse_messages, read_chunk, read_message_offsets
from hubodo.log.log_writer import LogWriter
from hubodo.log.recording_reader import open_log


@pytest.fixture(scope="module")
def chunks(tmp_path_factory: pytest.TempPathFactory):
    """Chunks of a recorder and of another writer, whose channels stand inside: (data, announced places)."""
    folder = tmp_path_factory.mktemp("chunks")
    with LogWriter(folder / "ours.mcap", chunk_bytes=20_000, clock=None) as log:
        for first in range(0, 400, 8):
            t = np.arange(first, first + 8) * 10_000_000
            log.write_imu("left", t, int(t[0]), np.ones((8, 3)), np.ones((8, 3)))
            log.write_temperature("left", t[:1], int(t[0]), [20.0])
            log.write_raw_frame("left", int(t[0]), bytes(first % 40))
    with (folder / "theirs.mcap").open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, chunk_size=2000)
        writer.start()
        channel = writer.register_channel("/raw", "x", 0)
        for i in range(300):
            writer.add_message(channel, i, bytes(i % 50), i)
        writer.finish()
    records = []
    for path in sorted(folder.glob("*.mcap")):
        with open_log(path) as log:
            fd = os.open(path, os.O_RDONLY)
            records += [
                (path.stem, read_chunk(fd, place), read_message_offsets(fd, place))
                for place in log.scan.chunks
            ]
            os.close(fd)
    return records


def test_announced_places_are_those_that_are_found_one_by_one(chunks):
    assert {name for name, _, _ in chunks} == {"ours", "theirs"}
    for name, data, places in chunks:
        one_by_one, at_once = parse_messages(data), parse_messages(data, places)
        assert np.array_equal(one_by_one.offsets, places) and len(places) > 3, name
        assert np.array_equal(at_once.headers, one_by_one.headers)
        assert at_once.definitions == one_by_one.definitions and at_once.is_complete


def lies(places: np.ndarray, rng: np.random.Generator):
    """The places with one that is missing, moved, twice, before or beyond the data; and none."""
    row = int(rng.integers(len(places)))
    yield np.delete(places, row)
    yield np.insert(places, row, places[row])
    for by in (1, -1, 1 << 40, -(1 << 40)):
        shifted = places.copy()
        shifted[row] += by
        yield np.sort(shifted)
    yield places[:0]


@pytest.mark.parametrize("seed", range(5))
def test_places_that_are_not_true_change_nothing(chunks, seed: int):
    rng = np.random.default_rng(seed)
    for name, data, places in chunks:
        expected = parse_messages(data)
        for wrong in lies(places, rng):
            records = parse_messages(data, wrong)
            assert np.array_equal(records.offsets, expected.offsets), name
            assert records.definitions == expected.definitions and records.is_complete == expected.is_complete


@pytest.mark.parametrize("seed", range(5))
def test_damaged_data_is_read_up_to_the_damage_as_one_by_one(chunks, seed: int):
    rng = np.random.default_rng(seed)
    for name, data, places in chunks:
        bad = bytearray(data)
        bad[int(places[len(places) // 2]) + int(rng.integers(0, 9))] ^= int(rng.integers(1, 256))
        expected, records = parse_messages(bytes(bad)), parse_messages(bytes(bad), places)
        assert (
            np.array_equal(records.offsets, expected.offsets) and records.is_complete == expected.is_complete
        ), name
