"""Recovery: every message of a complete chunk is recovered, none is invented, and the report is correct."""

import random
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from hubodo.errors import InputError, LogError
from hubodo.log.log_writer import LogWriter
from hubodo.log.logfile import LogMessage
from hubodo.log.recording_reader import open_log
from hubodo.log.recover import recover_log
from hubodo.recording import Event
from repetitions import first_and_more


def write_small(path: Path, compression="zstd", n: int = 14) -> None:
    """Write a few chunks of two links with metadata, and with attachment and event if n is large."""
    with LogWriter(
        path,
        t_zero_ns=0,
        compression=compression,
        chunk_bytes=10 * n,
        clock=None,
        metadata={"fingerprint": "abc"},
    ) as log:
        if n > 6:
            log.add_attachment("hubodo.toml", "application/toml", b"rate_hz = 208\n")
        for i in range(n):
            log.write_raw_frame("usb1", i * 1000 + 1, bytes([i] * 9))
            log.write_raw_frame("usb0", i * 1000 + 2, bytes([i] * i))
        if n > 6:
            log.write_event(Event(99, "gap", "left", "lost", {"samples_lost": 1}))


def messages(path: Path) -> list[LogMessage]:
    with open_log(path) as log:
        return list(log.messages())


def read_with_mcap(path: Path) -> list[tuple[str, int, int, int, bytes]]:
    """Return all messages as read by the mcap package by its index, with verified checksums."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        payloads = [
            (channel.topic, m.log_time, m.publish_time, m.sequence, m.data)
            for _, channel, m in reader.iter_messages()
        ]
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(payloads)
    return payloads


@pytest.mark.parametrize("compression", first_and_more("lz4", "zstd", "none"))
def test_from_a_log_cut_at_any_byte_every_complete_chunk_is_recovered_and_nothing_else(
    compression, tmp_path: Path
) -> None:
    whole = tmp_path / "whole.mcap"
    write_small(whole, compression, n=6)
    data = whole.read_bytes()
    with open_log(whole) as log:
        ends, counts, total = [], [], 0
        for place, chunk in zip(log.scan.chunks, log.chunks(), strict=True):
            total += len(chunk.offsets)
            ends.append(place.offset + place.length)
            counts.append(total)
    everything = sorted(read_with_mcap(whole), key=lambda m: (m[1], m[0]))
    written_order = _file_order(whole)
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    assert len(ends) >= 4
    seed = 3
    for size in _cuts(data, seed) if compression == "zstd" else _random_sizes(data, seed, 50):
        cut.write_bytes(data[:size])
        done = recover_log(cut, out)
        payloads = read_with_mcap(out)
        complete = max([count for end, count in zip(ends, counts, strict=True) if end <= size], default=0)
        assert len(payloads) >= complete, f"cut at byte {size}"
        assert set(payloads) == set(written_order[: len(payloads)]), f"cut at byte {size}"
        assert sum(done.messages.values()) == len(payloads)
        assert done.was_complete == (size == len(data))
        out.unlink()
    assert sorted(payloads, key=lambda m: (m[1], m[0])) == everything


def _random_sizes(data: bytes, seed: int, count: int) -> list[int]:
    """Return several sizes of a truncated file, and the full size."""
    return [*random.Random(seed).sample(range(8, len(data)), count), len(data)]


def _cuts(data: bytes, seed: int) -> list[int]:
    """Return sizes at each byte of the header and the last four bytes of each record, and 150 random."""
    sizes, at = set(_random_sizes(data, seed, 150)), 8
    while at < len(data) - 8:
        end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        sizes.update(range(at, min(at + 21, end)), range(end - 4, end + 1))
        at = end
    return sorted(sizes)


def _file_order(path: Path) -> list[tuple[str, int, int, int, bytes]]:
    payloads = []
    with open_log(path) as log:
        for chunk in log.chunks():
            for i, head in enumerate(chunk.headers):
                topic = log.streams[int(head["channel"])].topic
                times = int(head["log_time"]), int(head["publish_time"]), int(head["sequence"])
                payloads.append((topic, *times, chunk.payload(i)))
    return payloads


@pytest.mark.parametrize("size", range(8))
def test_less_than_the_magic_is_refused(size: int, tmp_path: Path) -> None:
    (tmp_path / "cut.mcap").write_bytes(b"\x89MCAP0\r\n"[:size])
    with pytest.raises(LogError):
        recover_log(tmp_path / "cut.mcap", tmp_path / "out.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["cut.mcap"]


def test_metadata_attachments_and_a_report_are_in_the_recovered_log(tmp_path: Path) -> None:
    write_small(tmp_path / "whole.mcap")
    data = (tmp_path / "whole.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    done = recover_log(tmp_path / "cut.mcap", tmp_path / "out.mcap")
    with (tmp_path / "out.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        records = {record.name: record.metadata for record in reader.iter_metadata()}
        assert [(a.name, a.data) for a in reader.iter_attachments()] == [("hubodo.toml", b"rate_hz = 208\n")]
    assert records["hubodo"]["fingerprint"] == "abc"
    assert records["hubodo.recovered"]["messages"] == str(sum(done.messages.values()))
    assert "bytes at the end are lost" in records["hubodo.recovered"]["lost"]
    assert done.bytes_read == len(data) // 2
    assert 0 < done.bytes_lost < 2000


def test_damaged_chunks_and_lost_records_lose_no_other_data(tmp_path: Path) -> None:
    write_small(tmp_path / "whole.mcap")
    data = bytearray((tmp_path / "whole.mcap").read_bytes())
    with open_log(tmp_path / "whole.mcap") as log:
        places = list(log.scan.chunks)
        sizes = [len(chunk.offsets) for chunk in log.chunks()]
    data[places[1].data_offset + 20] ^= 1
    data[places[2].offset + 3] ^= 0x80  # the length of the record: the positions of all later ones are lost
    (tmp_path / "bad.mcap").write_bytes(data)
    done = recover_log(tmp_path / "bad.mcap", tmp_path / "out.mcap")
    lost = set(_file_order(tmp_path / "whole.mcap")) - set(read_with_mcap(tmp_path / "out.mcap"))
    assert len(lost) == sizes[1] + sizes[2]
    assert len(done.losses) == 2
    assert not done.was_complete


@pytest.mark.parametrize("at", range(8))
def test_a_damaged_magic_loses_nothing(at: int, tmp_path: Path) -> None:
    write_small(tmp_path / "whole.mcap")
    data = bytearray((tmp_path / "whole.mcap").read_bytes())
    data[at] ^= 1
    (tmp_path / "bad.mcap").write_bytes(data)
    recover_log(tmp_path / "bad.mcap", tmp_path / "out.mcap")
    assert read_with_mcap(tmp_path / "out.mcap") == read_with_mcap(tmp_path / "whole.mcap")


@pytest.mark.parametrize("chunked", [True, False])
def test_a_truncated_log_of_another_writer_is_recovered_to_one_that_rosbags_reads(
    chunked: bool, tmp_path: Path
) -> None:
    with (tmp_path / "foreign.mcap").open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, use_chunking=chunked, chunk_size=1000)
        writer.start("ros2", "somebody else")
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data")
        channel = writer.register_channel("/speed", "cdr", schema)
        for i in range(300):
            writer.add_message(channel, i, b"\0\1\0\0" + np.float64(i).tobytes(), i)
        writer.finish()
    data = (tmp_path / "foreign.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    done = recover_log(tmp_path / "cut.mcap", tmp_path / "out.mcap")
    with AnyReader([tmp_path / "out.mcap"]) as reader:
        values = [reader.deserialize(raw, c.msgtype).data for c, _, raw in reader.messages()]
    assert values == list(range(len(values)))
    assert done.messages == {"/speed": len(values)}
    assert len(values) > 50


def test_no_file_is_overwritten_and_the_input_unchanged(tmp_path: Path) -> None:
    write_small(tmp_path / "log.mcap")
    before = (tmp_path / "log.mcap").read_bytes()
    with pytest.raises(InputError, match="is the log itself"):
        recover_log(tmp_path / "log.mcap", tmp_path / "log.mcap")
    (tmp_path / "out.mcap").write_bytes(b"precious")
    with pytest.raises(InputError, match="exists already"):
        recover_log(tmp_path / "log.mcap", tmp_path / "out.mcap")
    assert (tmp_path / "out.mcap").read_bytes() == b"precious"
    assert (tmp_path / "log.mcap").read_bytes() == before
