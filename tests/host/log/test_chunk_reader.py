"""Messages of a chunk: an index is used only if it agrees with the data."""

import os

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from hubodo.log.chunk_reader import parse_messages, read_chunk, read_message_offsets
from hubodo.log.log_writer import LogWriter
from hubodo.log.recording_reader import open_log


@pytest.fixture(scope="module")
def chunks(tmp_path_factory: pytest.TempPathFactory):
    """Return (writer, data, indexed offsets) of chunks of hubodo and of another writer."""
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


def test_indexed_offsets_are_those_found_by_reading_all_records(chunks):
    assert {name for name, _, _ in chunks} == {"ours", "theirs"}
    for name, data, offsets in chunks:
        sequential, indexed = parse_messages(data), parse_messages(data, offsets)
        assert np.array_equal(sequential.offsets, offsets) and len(offsets) > 3, name
        assert np.array_equal(indexed.headers, sequential.headers)
        assert indexed.definitions == sequential.definitions and indexed.is_complete


def false_offsets(offsets: np.ndarray, rng: np.random.Generator):
    """Yield the offsets with one missing, repeated, shifted, or outside the data; then no offset."""
    row = int(rng.integers(len(offsets)))
    yield np.delete(offsets, row)
    yield np.insert(offsets, row, offsets[row])
    for shift in (1, -1, 1 << 40, -(1 << 40)):
        shifted = offsets.copy()
        shifted[row] += shift
        yield np.sort(shifted)
    yield offsets[:0]


@pytest.mark.parametrize("seed", range(5))
def test_false_offsets_do_not_change_the_messages(chunks, seed: int):
    rng = np.random.default_rng(seed)
    for name, data, places in chunks:
        expected = parse_messages(data)
        for wrong in false_offsets(places, rng):
            records = parse_messages(data, wrong)
            assert np.array_equal(records.offsets, expected.offsets), name
            assert records.definitions == expected.definitions and records.is_complete == expected.is_complete


@pytest.mark.parametrize("seed", range(5))
def test_damaged_data_is_read_up_to_the_damage_with_or_without_an_index(chunks, seed: int):
    rng = np.random.default_rng(seed)
    for name, data, places in chunks:
        bad = bytearray(data)
        bad[int(places[len(places) // 2]) + int(rng.integers(0, 9))] ^= int(rng.integers(1, 256))
        expected, records = parse_messages(bytes(bad)), parse_messages(bytes(bad), places)
        assert (
            np.array_equal(records.offsets, expected.offsets) and records.is_complete == expected.is_complete
        ), name
