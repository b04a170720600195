"""Small files that claim huge sizes are refused or skipped within bounded memory."""

import resource
import struct
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard

from hubodo.log.mcap_file import McapFile
from hubodo.log.recording_reader import open_log
from in_process import hubodo
from vehicles import DRIVE_MODEL

CLAIMED = 1 << 30


def chunk(compression: str, data: bytes, size: int) -> bytes:
    """Return a chunk record without checksum, as another writer might create it."""
    name = compression.encode()
    body = struct.pack("<QQQII", 1, 2, size, 0, len(name)) + name + struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(body)) + body


def zeros(compression: str, size: int) -> bytes:
    """Return compressed zeros, which contain no opcode of a message record."""
    if compression == "zstd":
        packer = zstandard.ZstdCompressor(level=19).compressobj()
        return b"".join(packer.compress(bytes(1 << 20)) for _ in range(size >> 20)) + packer.flush()
    with lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX4MB) as packer:
        parts = [packer.begin()] + [packer.compress(bytes(1 << 20)) for _ in range(size >> 20)]
        return b"".join([*parts, packer.flush()])


def bomb(path: Path, *chunks: bytes) -> Path:
    file = McapFile(path)
    for record in chunks:
        file.append_records(record)
    file.finish()
    return path


def peak_megabytes(*words: object) -> float:
    """Return the peak memory of the command in a process of its own, MB."""
    program = textwrap.dedent("""
        import re, sys
        from hubodo.cli import main
        code = main(sys.argv[1:])
        # Not ru_maxrss: that begins with what the parent had when it forked.
        print(int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1024, code)
    """)
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, words)], capture_output=True, text=True, check=True
    )
    used, code = done.stdout.splitlines()[-1].split()
    assert code in ("0", "2"), done.stderr
    return float(used)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_log_of_some_kilobytes_does_not_allocate_gigabytes(compression: str, tmp_path: Path) -> None:
    some = 1 << 25 if compression == "zstd" else 1 << 23
    packed = zeros(compression, some)
    liars = [chunk(compression, packed, some)] * 40 + [chunk(compression, packed, CLAIMED)]
    path = bomb(tmp_path / "bomb.mcap", *liars)
    assert path.stat().st_size < 2_000_000
    used = peak_megabytes("info", path)
    print(f"{compression}: {path.stat().st_size / 1e3:.0f} kB take {used:.0f} MB")
    assert used < 600
    with open_log(path) as log:
        assert list(log.messages()) == []
        list(log.chunks())
        assert any("more than such a file can hold" in line for line in log.warnings())


def test_the_size_in_a_truncated_chunk_is_checked_too(tmp_path: Path) -> None:
    packed = zeros("zstd", 1 << 28)
    whole = bomb(tmp_path / "whole.mcap", chunk("zstd", packed + bytes(1000), 1 << 28)).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: whole.index(packed) + len(packed)])
    assert peak_megabytes("recover", cut, "-o", tmp_path / "out.mcap") < 500


def test_a_chunk_of_a_million_channels_keeps_each_once(tmp_path: Path) -> None:
    record = struct.pack("<BQHHI", 4, 24, 1, 0, 2) + b"/a" + struct.pack("<I", 4) + b"json" + bytes(4)
    path = bomb(tmp_path / "channels.mcap", chunk("", record * 300_000, len(record) * 300_000))
    with open_log(path) as log:
        (messages,) = log.chunks()
        assert len(messages.definitions) == 1
        assert [stream.topic for stream in log.streams.values()] == ["/a"]


def noise(path: Path, stamps: np.ndarray) -> Path:
    values = np.random.default_rng(3).normal(0, 1e-3, len(stamps))
    rows = [
        f"{t!r},{g!r},{g!r},{g!r},0,0,9.81" for t, g in zip(stamps.tolist(), values.tolist(), strict=True)
    ]
    path.mkdir()
    (path / "left.csv").write_text("t,gx,gy,gz,ax,ay,az\n" + "\n".join(rows) + "\n")
    return path


def test_a_wild_time_stamp_creates_no_grid_of_gigabytes(tmp_path: Path) -> None:
    t = np.arange(3000) * 0.01
    t[-1] = 2e9
    done = hubodo("allan", noise(tmp_path / "log", t), "--node", "left", "--channel", "gz", "--trust-still")
    assert done.code == 2
    assert "2e+09 s" in done.err and "--end" in done.err


def test_no_verb_creates_a_grid_up_to_a_wild_time_stamp(tmp_path: Path) -> None:
    model, vehicle, drive = tmp_path / "m.toml", tmp_path / "v.toml", tmp_path / "drive"
    model.write_text(DRIVE_MODEL)
    head, _, remainder = DRIVE_MODEL.partition("[imu]")
    vehicle.write_text(head + remainder[remainder.index("[nodes") : remainder.index("[inputs")])
    assert hubodo("simulate", model, "--duration", 25, "--rate", 50, "-o", drive).code == 0
    for file in drive.iterdir():
        head, _, last = file.read_text().strip().rpartition("\n")
        file.write_text(f"{head}\n2000000000,{last.partition(',')[2]}\n")
    (drive / "wheels.csv").write_text("t,left,right\n0,1,1\n0.1,1,1\n2000000000,1,1\n")
    with limited_memory(500):
        for code, words in (
            (0, ["info", drive]),
            (2, ["fuse", drive, "--vehicle", vehicle, "-o", tmp_path / "2", "--method", "differential"]),
            (2, ["fuse", drive, "--vehicle", vehicle, "-o", tmp_path / "1"]),
            (2, ["gap", model, drive, "-o", tmp_path / "3"]),
            (2, ["simulate", model, "--drive", "reference", "--from", drive, "-o", tmp_path / "s.mcap"]),
            (0, ["calibrate", "wheels", drive, "--vehicle", vehicle, "-o", tmp_path / "c.toml"]),
        ):
            done = hubodo(*words)
            assert done.code == code, done.err
            assert code == 0 or "wild time stamp" in done.err


@contextmanager
def limited_memory(megabytes: int) -> Iterator[None]:
    """Limit the memory to this much beyond the present use."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + megabytes * 10**6, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def test_an_array_that_claims_more_than_its_file_holds_is_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("gyro", (1 << 36,), "f8", chunks=(1 << 20,), fillvalue=0.0)
    done = hubodo("allan", tmp_path / "a.h5", "--rate", 100, "--unit", "rad/s")
    assert done.code == 2 and "claims" in done.err
    head = np.lib.format.magic(1, 0)
    text = b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999,), }".ljust(117) + b"\n"
    (tmp_path / "a.npy").write_bytes(head + struct.pack("<H", len(text)) + text + bytes(800))
    done = hubodo("allan", tmp_path / "a.npy", "--rate", 100, "--unit", "rad/s")
    assert done.code == 2


def test_a_failed_allocation_is_an_error_of_one_line(tmp_path: Path) -> None:
    for name, count in (("small", 5_000), ("large", 20_000_000)):
        np.save(tmp_path / name, 1e-3 * np.random.default_rng(1).standard_normal(count))
    words = ["--rate", 100, "--unit", "rad/s"]
    assert hubodo("allan", tmp_path / "small.npy", *words).code == 0
    with limited_memory(2):
        done = hubodo("allan", tmp_path / "large.npy", *words)
    assert done.code == 1
    assert "not enough memory" in done.err and done.err.count("\n") == 1
