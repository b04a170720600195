"""A disk that fills up, is read-only or disappears: one line, exit code 1, no incomplete file."""

import os
import re
import resource
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from fuzz import seeds
from fuzz.targets import drive
from hubodo.atomic_files import atomic_files, atomic_new_file
from hubodo.errors import InputError
from in_process import hubodo

VERBS = {
    "import": ("import", "IN/drive", "-o", "OUT/a.mcap"),
    "example": ("example", "OUT/a"),
    "batch": ("batch", "info", "IN/drive.mcap", "-o", "OUT/a"),
    "import again": ("import", "IN/raw.mcap", "-o", "OUT/a.mcap"),
    "export": ("export", "IN/drive.mcap", "-o", "OUT/a"),
    "export to a bag": ("export", "IN/drive.mcap", "--format", "rosbag2", "-o", "OUT/a"),
    "recover": ("recover", "IN/drive.mcap", "-o", "OUT/a.mcap"),
    "fuse": ("fuse", "IN/drive.mcap", "--vehicle", "IN/v.toml", "-o", "OUT/a"),
    "simulate": ("simulate", "IN/m.toml", "--duration", "6", "-o", "OUT/a.mcap"),
    "simulate to CSV": ("simulate", "IN/m.toml", "--duration", "6", "-o", "OUT/a"),
    "gap": ("gap", "IN/m.toml", "IN/drive", "-o", "OUT/a"),
    "report": ("report", "IN/drive.mcap", "-o", "OUT/a.html"),
    "calibrate wheels": ("calibrate", "wheels", "IN/drive", "--vehicle", "IN/v.toml", "-o", "OUT/a.toml"),
    "heading": ("heading", "IN/upright", "--node", "left", "-o", "OUT/a.csv", "--figure", "OUT/a.png",
                "--report", "OUT/a.html"),
}  # fmt: skip


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Create a drive in two formats, a log with raw frames, an upright gyro, and settings."""
    folder = tmp_path_factory.mktemp("given")
    (folder / "m.toml").write_text(seeds.MODEL)
    (folder / "v.toml").write_text(seeds.VEHICLE)
    (folder / "drive").mkdir()
    for name, text in drive().items():
        (folder / "drive" / name).write_text(text)
    assert hubodo("import", folder / "drive", "-o", folder / "drive.mcap").code == 0
    seeds.our_log(folder / "raw.mcap")
    (folder / "upright").mkdir()
    noise = np.random.default_rng(1).normal((0, 0, 0, 0, 0, 9.81), 1e-3, (2000, 6))
    rows = "".join(f"{k / 50},{','.join(map(repr, row))}\n" for k, row in enumerate(noise.tolist()))
    (folder / "upright" / "left.csv").write_text("t,gx,gy,gz,ax,ay,az\n" + rows)
    return folder


def run(words: tuple[str, ...], given: Path, out: Path):
    return hubodo(*(word.replace("IN", str(given)).replace("OUT", str(out)) for word in words))


@contextmanager
def no_more_than(size: int) -> Iterator[None]:
    """Limit the size of files: the system refuses further writes, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    old = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, old)


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("verb", VERBS)
def test_a_disk_that_fills_at_any_stage_leaves_no_incomplete_file(
    verb: str, given: Path, tmp_path: Path
) -> None:
    """The disk fills at the first byte, the last, or between files: files with final names are complete."""
    done = run(VERBS[verb], given, tmp_path)
    assert done.code == 0, done.err
    whole = files(tmp_path)
    sizes = sorted({len(content) for content in whole.values()})
    # A table of batch that lacks a log is complete.
    limits = {"gap": {sizes[0]}, "batch": {1}}.get(verb, {1, sizes[0] - 1, sizes[-1] - 1})
    for size in sorted(limits):
        shutil.rmtree(tmp_path)
        tmp_path.mkdir()
        with no_more_than(size):
            done = run(VERBS[verb], given, tmp_path)
        assert done.code == 1, f"{size} bytes: {done}"
        assert done.err.count("\n") == 1 and re.search("File too large|disk I/O error", done.err), done.err
        assert str(tmp_path) in done.err and ".part" not in done.err, done.err
        left = files(tmp_path)
        assert set(left) < set(whole), f"{size} bytes"
        assert all(len(left[name]) == pytest.approx(len(whole[name]), rel=0.05) for name in left)
        assert not any(path.name.startswith(".") for path in tmp_path.rglob("*"))


def test_a_calibration_that_cannot_be_written_stays_as_it_was(given: Path, tmp_path: Path) -> None:
    words = VERBS["calibrate wheels"]
    assert run(words, given, tmp_path).code == 0
    before = files(tmp_path)
    with no_more_than(100):
        assert run(words, given, tmp_path).code == 1
    assert files(tmp_path) == before


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a file system of 64 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", folder], capture_output=True)
    if mounted.returncode:
        pytest.skip("a small file system cannot be mounted without the rights of root")
    yield folder
    subprocess.run(["umount", "-l", folder], check=True)


@pytest.mark.parametrize("verb", ["import", "export", "recover", "report", "simulate", "fuse"])
def test_a_full_file_system_is_one_line_and_leaves_no_file(verb: str, given: Path, small_disk: Path) -> None:
    (small_disk / "other").write_bytes(bytes(60_000))
    done = run(VERBS[verb], given, small_disk)
    assert done.code == 1 and "No space left on device" in done.err and done.err.count("\n") == 1
    assert list(small_disk.iterdir()) == [small_disk / "other"]


@pytest.mark.parametrize("verb", ["import", "export", "report", "fuse", "calibrate wheels"])
def test_a_read_only_folder_is_named_in_one_line(verb: str, given: Path, small_disk: Path) -> None:
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    done = run(VERBS[verb], given, small_disk)
    assert done.code == 1 and "Read-only file system" in done.err and done.err.count("\n") == 1
    assert str(small_disk) in done.err and ".part" not in done.err


def test_a_folder_removed_before_the_result_is_written(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    with pytest.raises(FileNotFoundError, match=r"out/a\.txt"), atomic_files(folder / "a.txt") as (part,):
        shutil.rmtree(folder)
        part.write_text("x")
    with pytest.raises(InputError, match="does not exist"), atomic_files(folder / "a.txt"):
        pass


def test_several_files_get_their_names_together_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    with pytest.raises(OSError, match="disk"), atomic_files(tmp_path / "a", tmp_path / "b") as (a, b):
        a.write_text("new")
        b.write_text("new")
        raise OSError("disk")
    assert files(tmp_path) == {"a": b"old"}
    with atomic_files(tmp_path / "a", tmp_path / "b") as (a, b):
        a.write_text("new")
        b.write_text("new")
        assert (tmp_path / "a").read_text() == "old"
    assert files(tmp_path) == {"a": b"new", "b": b"new"}


def test_a_folder_created_for_a_failed_result_is_removed(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), atomic_files(tmp_path / "x" / "y" / "a", create_folder=True):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_file_created_by_others_while_writing_is_not_overwritten(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="exists already"), atomic_new_file(tmp_path / "a") as part:
        part.write_text("mine")
        (tmp_path / "a").write_text("theirs")
    assert files(tmp_path) == {"a": b"theirs"}


def test_devices_and_pipes_are_written_directly(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with atomic_files(pipe) as (part,):
        part.write_text("x")
    assert os.read(reader, 10) == b"x" and pipe.is_fifo()
    os.close(reader)
