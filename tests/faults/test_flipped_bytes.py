"""A flip of any byte of a small log is detected, or leaves all contents unchanged."""

import json
import random
import struct
from pathlib import Path

import pytest

from hubodo.errors import LogError
from hubodo.log.log_writer import LogWriter
from hubodo.log.recording_reader import open_log
from hubodo.log.recover import recover_log
from hubodo.recording import Event
from in_process import hubodo
from repetitions import first_and_more
from vehicles import vehicle_toml

VEHICLE = vehicle_toml(facing={}).encode()


def write_log(path: Path, compression: str) -> None:
    """Write a log with two links, an event, metadata and an attachment: every kind of MCAP record."""
    with LogWriter(
        path,
        t_zero_ns=1_700_000_000 * 10**9,
        compression=compression,  # type: ignore[arg-type]
        chunk_bytes=150,
        clock=None,
        metadata={"fingerprint": "abc"},
    ) as log:
        log.add_attachment("vehicle.toml", "application/toml", VEHICLE)
        speed = log.add_channel("/speed", "std_msgs/msg/Float64", "ros2msg", b"float64 data", "cdr")
        for i in range(3):
            log.write_raw_frame("usb1", log.t_zero_ns + i * 1000 + 1, bytes([i] * 9))
            log.write(speed, log.t_zero_ns + i, log.t_zero_ns + i, bytes(4) + struct.pack("<d", i))
        log.write_event(Event(log.t_zero_ns + 99, "gap", "left", "lost", {"samples_lost": 1}))


def everything(path: Path) -> tuple[tuple[object, ...], tuple[str, ...]]:
    """Return the contents of a log by all readers, attachments first, and its warnings."""
    with open_log(path) as log:
        by_time = list(log.messages())
        in_file = [chunk.data.tobytes() for chunk in log.chunks()]
        output = (log.attachments, by_time, in_file, log.streams, log.metadata_records, log.t_zero_ns)
        return (*output, log.scan.library, log.scan.profile), log.warnings()


@pytest.mark.parametrize(
    ("compression", "step"), [("none", 31), *first_and_more(("zstd", 7), ("zstd", 1), ("none", 5))]
)
def test_each_changed_byte_is_detected(compression: str, step: int, tmp_path: Path) -> None:
    seed, path, bad = 5, tmp_path / "log.mcap", tmp_path / "bad.mcap"
    rng = random.Random(seed)
    write_log(path, compression)
    truth, warnings = everything(path)
    assert not warnings
    data = path.read_bytes()
    harmless = 0
    for at in range(0, len(data), step):
        turned = bytearray(data)
        turned[at] ^= 1 << rng.randrange(8)
        bad.write_bytes(turned)
        try:
            contents, warnings = everything(bad)
        except LogError:
            assert at < 8, f"byte {at}, seed {seed}: only the magic makes it no log"
            continue
        assert warnings, f"byte {at} of {len(data)} is not noticed, seed {seed}"
        assert contents[0] in ({}, truth[0]), f"byte {at}: a damaged attachment is given out, seed {seed}"
        harmless += contents == truth
    print(f"{len(data[::step])} of {len(data)} bytes: all noticed; {harmless} change nothing read")


def test_a_changed_radius_and_a_changed_zero_of_time_are_reported_by_the_verbs(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_log(path, "zstd")
    data = path.read_bytes()
    path.write_bytes(data.replace(b"0.31", b"0.41"))
    warnings = hubodo("info", path, "--json")
    assert "vehicle.toml fails its checksum" in warnings.out
    assert json.loads(warnings.out)["damaged"] == 1 and json.loads(warnings.out)["attachments"] == {}
    assert "1 damaged places" in hubodo("info", path).out
    done = recover_log(path, tmp_path / "whole.mcap")
    assert not done.was_complete and "vehicle.toml" in done.losses[0]
    path.write_bytes(data.replace(b"1700000000000000000", b"1700000100000000000"))
    assert "t = 0" in hubodo("info", path).out
    assert "t = 0" in hubodo("recover", path, "-o", tmp_path / "again.mcap").out
