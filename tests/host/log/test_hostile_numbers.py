"""Numeric files with implausible headers or contents are refused in one line, within the memory limit."""

import gzip
import os
import struct
import warnings
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from hubodo.errors import InputError
from hubodo.log.input_limits import memory_limit
from hubodo.log.number_file import detect_file_kind, read_numbers
from in_process import hubodo

BODY = np.arange(100.0).tobytes()


def npy(shape: str, dtype: str = "'<f8'", body: bytes = BODY) -> bytes:
    head = f"{{'descr': {dtype}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + body


def element(kind: int, data: bytes) -> bytes:
    """Return one element of a MATLAB 5 file with its tag and padding."""
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def mat(dims: tuple[int, int], kind: int = 6, data: bytes = b"", *, packed: bool = False) -> bytes:
    """Return a MATLAB 5 file with one array; kind: 6 of doubles, 1 of cells."""
    head = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + struct.pack("<H", 0x100) + b"IM"
    content = element(6, struct.pack("<II", kind, 0)) + element(5, struct.pack("<ii", *dims))
    content = element(14, content + element(1, b"gz") + data)
    if packed:
        small = zlib.compress(content)
        content = struct.pack("<II", 15, len(small)) + small
    return head + content


def read(path: Path, variable: str | None = None) -> np.ndarray:
    with memory_limit(20_000_000):
        return read_numbers(path, detect_file_kind(path), variable).values


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (npy("(1000000000000,)"), "needs 16000000 MB of memory"),
        (npy("(4294967296, 4294967296)"), "no array of numbers"),
        (npy("(-5,)"), "no array of numbers"),
        (npy("(1000,)"), "claims 1000 numbers, which need 8000 bytes, but 800 bytes follow"),
        (npy("(10,)", "'|O'"), "Python objects"),
        (npy("(50,)", "[('a', '<f8'), ('b', '<f8')]"), "no array of numbers"),
        (npy("(" + "9" * 5000 + ",)"), "header of x is damaged"),
        (npy("(" * 9000), "header of x is damaged"),
        (npy("-" * 9000 + "1"), "header of x is damaged"),
        (npy("(3,)" + " " * 20_000), "header of x is damaged"),
    ],
)
def test_a_numpy_header_is_compared_with_the_file_before_memory_is_allocated(
    tmp_path, content, message
) -> None:
    (tmp_path / "x.npy").write_bytes(content)
    with pytest.raises(InputError, match=rf"x\.npy: .*{message}"):
        read(tmp_path / "x.npy")


def test_an_archive_that_expands_beyond_the_limit_or_is_ambiguous_is_refused(tmp_path) -> None:
    def archive(name: str, *entries: tuple[str, bytes], how: int = zipfile.ZIP_DEFLATED) -> Path:
        with zipfile.ZipFile(tmp_path / name, "w", how) as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for entry in entries:
                file.writestr(*entry)
        return tmp_path / name

    small = ("a.npy", npy("(100,)"))
    bomb = archive("bomb.npz", ("a.npy", npy("(4000000,)", body=bytes(32_000_000))))
    assert bomb.stat().st_size < 100_000
    encrypted = archive("locked.npz", small)
    data = bytearray(encrypted.read_bytes())
    data[data.rfind(b"PK\x01\x02") + 8] |= 1
    encrypted.write_bytes(data)
    cut = archive("cut.npz", small)
    cut.write_bytes(cut.read_bytes()[:-30])
    for path, message in (
        (bomb, "the array a needs 64 MB of memory, the limit is 20 MB"),
        (archive("twice.npz", small, small), "two arrays of one name"),
        (archive("short.npz", ("a.npy", npy("(500,)"))), "its data end earlier"),
        (archive("lzma.npz", small, how=zipfile.ZIP_LZMA), "compressed as numpy does not"),
        (encrypted, "damaged .npz file .*encrypted"),
        (cut, "damaged .npz file"),
    ):
        with pytest.raises(InputError, match=message):
            read(path)
    both = archive("both.npz", ("big.npy", npy("(4000000,)", body=bytes(32_000_000))), small)
    assert read(both, "a").shape == (100, 1)  # the array that is not selected is not expanded


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (lambda: mat((1 << 30, 1), 1), "needs more than 10 MB to decode"),
        (lambda: mat((2**31 - 1, 1), data=element(9, BODY)), "cannot be read"),
        (
            lambda: mat((4_000_000, 1), data=element(9, bytes(32_000_000)), packed=True),
            "needs more than 10 MB",
        ),
        (lambda: struct.pack("<5i", 0, 2**31 - 1, 2**31 - 1, 0, 3) + b"gz\0" + BODY, "cannot be read"),
    ],
    ids=["cells", "dimensions", "compressed", "version 4"],
)
def test_a_matlab_file_is_decoded_within_the_limit(tmp_path, content, message) -> None:
    (tmp_path / "x.mat").write_bytes(content())
    with pytest.raises(InputError, match=rf"x\.mat: .*{message}"):
        read(tmp_path / "x.mat")


def test_both_generations_of_matlab_files_are_read(tmp_path) -> None:
    for form in ("4", "5"):
        scipy.io.savemat(tmp_path / "x.mat", {"gz": np.arange(50.0)}, format=form)
        np.testing.assert_array_equal(read(tmp_path / "x.mat")[:, 0], np.arange(50.0))


def test_hdf5_with_links_to_other_files_or_false_sizes_is_refused(tmp_path) -> None:
    (tmp_path / "other.bin").write_bytes(BODY)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["gz"] = np.arange(100.0)
    layout = h5py.VirtualLayout((100,), "f8")
    layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "gz", (100,))
    own = np.arange(9.0)
    elsewhere, zeros = h5py.ExternalLink("other.h5", "/gz"), np.zeros(4_000_000)
    for name, message, build in (
        ("storage", "not followed", lambda f: f.create_dataset("gz", 100, "f8", external="other.bin")),
        ("virtual", "not followed", lambda f: f.create_virtual_dataset("gz", layout)),
        ("link", "not followed", lambda f: f.update(gz=elsewhere, own=own)),
        ("chunks", "claims 10", lambda f: f.create_dataset("gz", 1 << 40, "f8", chunks=(1 << 20,))),
        ("bomb", "claims 4", lambda f: f.create_dataset("gz", data=zeros, compression=9)),
    ):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            build(file)
        with pytest.raises(InputError, match=rf"{name}\.h5: gz .*{message}"):
            read(tmp_path / f"{name}.h5")
    assert read(tmp_path / "link.h5", "own").shape == (9, 1)


def test_a_crash_of_a_library_is_an_error_of_one_line(tmp_path, monkeypatch) -> None:
    # An interpreter killed by a signal stands for a crashing library.
    script = tmp_path / "python"
    script.write_text("#!/bin/sh\nkill -SEGV $$\n")
    script.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(script))
    (tmp_path / "x.mat").write_bytes(mat((1, 100), data=element(9, BODY)))
    with pytest.raises(InputError, match=r"damaged MATLAB file .*SIGSEGV"):
        read(tmp_path / "x.mat")


def test_rows_of_text_are_read_within_the_limit(tmp_path) -> None:
    with gzip.open(tmp_path / "bomb.csv.gz", "wb") as file:
        file.write(b"t,gz\n" + b"1.0,2\n" * 1_000_000)
    with pytest.raises(InputError, match=r"bomb\.csv\.gz: its table needs 2[0-9] MB of memory"):
        read(tmp_path / "bomb.csv.gz")
    for content, message in (
        (b"t,gz\n0,1\n1,2020-01-02\n", "row 3: '2020-01-02' is not a number"),
        (b"t,gz\n0,1\n1,\xff\n", "not UTF-8"),
        (b"t,gx,gz\n0,1\n1,2\n", "row 2 has 2 columns, the first 3"),
        (gzip.compress(b"t,gz\n0,1\n")[:-9], "cannot be unpacked"),
        (gzip.compress(npy("(100,)")), "compressed file of another kind"),
        (b"1," * 600_000 + b"1\n", "row 1 is longer than"),
    ):
        (tmp_path / "x.csv").write_bytes(content)
        with pytest.raises(InputError, match=message):
            read(tmp_path / "x.csv")
    (tmp_path / "x.csv").write_bytes(b"\xef\xbb\xbft,gz\r\n# comment\r\n0,1\r\n1," + b"9" * 5000 + b"\r\n")
    np.testing.assert_array_equal(read(tmp_path / "x.csv"), [[0.0, 1.0], [1.0, np.inf]])


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no FIFO")
def test_a_pipe_in_place_of_a_file_of_numbers_is_refused(tmp_path) -> None:
    os.mkfifo(tmp_path / "x.csv")
    done = hubodo("allan", tmp_path / "x.csv", "--rate", 100, "--unit", "rad/s")
    assert done.code == 2
    assert "not a regular file" in done.err


def test_values_whose_variance_underflows_are_refused(tmp_path) -> None:
    np.save(tmp_path / "x.npy", 1e-300 * np.arange(300.0))
    words = ("--rate", 100, "--unit", "rad/s", "--trust-units", "--as-is")
    done = hubodo("allan", tmp_path / "x.npy", *words)
    assert done.code == 2
    assert "check the unit" in done.err
