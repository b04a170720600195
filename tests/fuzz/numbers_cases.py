"""Cases of numeric files: .npy, .npz, MATLAB, HDF5 and text, gzipped or not, changed at meaningful places."""

from __future__ import annotations

import gzip
import io
import random
import struct
import tempfile
import warnings
import zipfile
import zlib
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import scipy.io

from fuzz.case import Case
from fuzz.mutate_mcap import DOUBLES, NUMBERS, torn
from fuzz.mutate_text import mutated_csv

_ROWS = 300
SHAPES = (
    "(300,)", "(300, 1)", "(7, 300)", "(0,)", "(-1,)", "(1,)", "()", "(1000000000000,)",
    "(4294967296, 4294967296)",
    "(300.0,)", "(True,)", "('a',)", "(300, 0, 5)", "(" + "9" * 4000 + ",)", "(" + "9" * 5000 + ",)",
    "(1e300,)",
    "(" * 150 + ")" * 150, "-" * 5000 + "1", "None", "[300]", "(301,)", "(299,)", "(1, 2, 3, 4)", "((3,),)",
)  # fmt: skip
DESCRIPTIONS = (
    "'<f8'", "'>f8'", "'<f4'", "'<i2'", "'|u1'", "'|b1'", "'|O'", "'<f16'", "'<c16'", "'<M8[ns]'", "'|V0'",
    "'<U9999999'",
    "'|S0'", "[('a', '<f8')]", "[('a', '|O')]", "('<f8', (3,))", "'f8,f8'", "{'a': 1}", "b'x'", "''",
    "'<f2'", "1", "'<f9'",
)  # fmt: skip
WORDS = (
    ("allan", "FILE", "--rate", "100", "--unit", "rad/s", "--as-is", "--trust-units", "--json"),
    ("allan", "FILE", "--rate", "100", "--unit", "rad/s", "--variable", "gz", "--trust-units"),
    ("allan", "FILE", "--unit", "rad/s", "--as-is", "--trust-units", "--trust-still"),
    ("allan", "FILE", "--unit", "deg/s", "--columns", "t,gz"),
    ("allan", "FILE", "--unit", "g", "--columns", "t,gx,gy,gz,ax,ay,az"),
    ("warmup", "FILE", "--rate", "100", "--unit", "rad/s", "--trust-units"),
    ("heading", "FILE", "--rate", "100", "--unit", "rad/s", "--axis", "z"),
    ("info", "FILE", "--json"),
    ("import", "FILE", "-o", "FOLDER/out.mcap"),
)


def _case(rng: random.Random, name: str, data: bytes) -> Case:
    if rng.random() < 0.05:
        data, name = gzip.compress(data, 1), f"{name}.gz"
    words = rng.choice((*WORDS[:3] * 3, *WORDS))
    return Case(tuple(f"FOLDER/{name}" if word == "FILE" else word for word in words), {name: data})


def npy_case(rng: random.Random) -> Case:
    """Return a .npy file with a changed header or changed bytes."""
    return _case(rng, "x.npy", _mutated_npy(rng, rng.choice(_arrays())))


def npz_case(rng: random.Random) -> Case:
    """Return a .npz file with changed or duplicate members, other compression, or a false directory."""
    out = io.BytesIO()
    compression = rng.choice(
        (zipfile.ZIP_DEFLATED,) * 3 + (zipfile.ZIP_STORED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2)
    )
    with zipfile.ZipFile(out, "w", compression) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in rng.choices(("gz", "t", "a/b", "../x", "é", "", "gz.txt"), k=rng.randint(0, 4)):
            data = rng.choice(_arrays())
            suffix = "" if name.endswith("txt") else ".npy"
            archive.writestr(f"{name}{suffix}", _mutated_npy(rng, data) if rng.random() < 0.5 else data)
        if rng.random() < 0.1:
            archive.writestr("bomb.npy", _npy("(30000000,)", "'<f8'", bytes(1_000_000)))
    changed = bytearray(out.getvalue())
    if rng.random() < 0.5:
        for _ in range(rng.randint(1, 3)):
            _change_record(rng, changed, (b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06"), 46)
    return _case(rng, "x.npz", bytes(torn(rng, bytes(changed)) if rng.random() < 0.1 else changed))


def mat_case(rng: random.Random) -> Case:
    """Return a MATLAB file of version 4 or 5 with changed tags, sizes and dimensions, compressed or not."""
    data = bytearray(rng.choice(_matlab()))
    for _ in range(rng.randint(1, 4)):
        if rng.random() < 0.3 and len(data) > 144 and data[128] == 15:
            data = _repacked(rng, data)
        elif data:
            # Tags, flags and dimensions are 32-bit numbers near the beginning of each element.
            limit = min(len(data), 128 + 120) if rng.random() < 0.7 else len(data)
            place = rng.randrange(0 if data[0] == 0 else min(124, limit - 1), limit) & ~3
            data[place : place + 4] = (rng.choice((*NUMBERS, 14, 15, 9, 6, 1, 2, 3)) & 0xFFFFFFFF).to_bytes(
                4, "little"
            )
    return _case(rng, "x.mat", bytes(torn(rng, bytes(data)) if rng.random() < 0.15 else data))


def hdf5_case(rng: random.Random) -> Case:
    """Return an HDF5 file with a changed structure, or one that claims too much or links to other files."""
    if rng.random() < 0.25:
        return _case(rng, "x.h5", _unusual_hdf5(rng))
    data = bytearray(rng.choice(_hdf5()))
    for _ in range(rng.randint(1, 6)):
        size = rng.choice((1, 2, 4, 8))
        place = rng.randrange(len(data)) & -size
        value = rng.choice((*NUMBERS, rng.randrange(1 << 16), rng.randrange(len(data))))
        data[place : place + size] = (value & ((1 << 8 * size) - 1)).to_bytes(size, "little")
    return _case(rng, "x.h5", bytes(torn(rng, bytes(data)) if rng.random() < 0.1 else data))


def text_case(rng: random.Random) -> Case:
    """Return a file of rows with changed cells, separators, encodings; gzipped, truncated or enormous."""
    data = mutated_csv(rng, rng.choice(_texts()))
    choice = rng.random()
    if choice < 0.1:
        data = data.decode("utf-8", "replace").encode(rng.choice(("utf-16", "utf-32", "cp1252")), "replace")
    elif choice < 0.15:
        data += b"1" * 3_000_000
    elif choice < 0.2:
        return _case(rng, "x.csv.gz", bytes(torn(rng, gzip.compress(data, 1))))
    elif choice < 0.23:
        return _case(rng, "x.csv.gz", _bomb())
    elif choice < 0.3:
        return _case(rng, "x.csv.gz", gzip.compress(gzip.compress(data, 1), 1))
    return _case(rng, "x.csv", data)


def _npy(shape: str, description: str, body: bytes, order: str = "False") -> bytes:
    head = f"{{'descr': {description}, 'fortran_order': {order}, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", min(len(head), 65535)) + head + body


def _mutated_npy(rng: random.Random, data: bytes) -> bytes:
    if rng.random() < 0.2:
        rows = np.frombuffer(data, "<f8", 300, 128).copy()
        rows[rng.sample(range(300), 4)] = rng.choices(DOUBLES, k=4)
        return _npy("(300,)", "'<f8'", rows.tobytes())
    if rng.random() < 0.6:
        shape = rng.choice(SHAPES) if rng.random() < 0.7 else "(300,)"
        description = rng.choice(DESCRIPTIONS) if rng.random() < 0.5 else "'<f8'"
        return _npy(shape, description, data[128:], rng.choice(("False", "True", "1", "None")))
    if rng.random() < 0.5:
        changed = bytearray(data)
        changed[rng.randrange(6, 128)] = rng.choice((0, 0xFF, 0x28, 0x5B, rng.randrange(256)))
        return bytes(changed)
    return bytes(torn(rng, data))


def _change_record(rng: random.Random, data: bytearray, magics: tuple[bytes, ...], size: int) -> None:
    """Change one number behind one of the marks of a record."""
    magic = rng.choice(magics)
    places = (
        [k for k in range(len(data)) if data.startswith(magic, k)]
        if len(data) < 50_000
        else [data.find(magic)]
    )
    if not places or places[0] < 0:
        return
    width = rng.choice((2, 4))
    place = rng.choice(places) + rng.randrange(4, size, 2)
    data[place : place + width] = (rng.choice(NUMBERS) & ((1 << 8 * width) - 1)).to_bytes(width, "little")


def _repacked(rng: random.Random, data: bytearray) -> bytearray:
    """Change the content of the first compressed element of a MATLAB 5 file."""
    (length,) = struct.unpack_from("<I", data, 132)
    try:
        inside = bytearray(zlib.decompress(data[136 : 136 + length]))
    except zlib.error:
        return data
    place = rng.randrange(max(1, min(len(inside), 100))) & ~3
    inside[place : place + 4] = (rng.choice((*NUMBERS, 1, 2, 3, 9, 14)) & 0xFFFFFFFF).to_bytes(4, "little")
    if rng.random() < 0.1:
        inside += bytes(20_000_000)
    small = zlib.compress(inside, 1)
    return data[:132] + struct.pack("<I", len(small)) + small + data[136 + length :]


def _unusual_hdf5(rng: random.Random) -> bytes:
    with tempfile.TemporaryDirectory(prefix="hubodo-fuzz-") as folder:
        path = Path(folder) / "x.h5"
        with h5py.File(path, "w", libver=rng.choice(("earliest", "latest"))) as file:
            for name in ("gz", "t")[: rng.randint(1, 2)]:
                _unusual_dataset(rng, file, name)
            if rng.random() < 0.3 and isinstance(file.get("gz", getlink=True), h5py.HardLink):
                file["gz"].attrs["units"] = rng.choice(
                    ("deg/s", b"\xff", 5, np.arange(3), "x" * 9999, h5py.Empty("f8"))
                )
        return path.read_bytes()


def _unusual_dataset(rng: random.Random, file: h5py.File, name: str) -> None:
    layout = h5py.VirtualLayout((_ROWS,), "f8")
    layout[:] = h5py.VirtualSource("/etc/hostname", "gz", (_ROWS,))
    rng.choice((
        lambda: file.create_dataset(name, (1 << 40,), "f8", chunks=(1 << 20,), compression=9),
        lambda: file.create_dataset(name, (1 << 24,), "f8", chunks=(1 << 24,)),
        lambda: file.create_dataset(name, data=np.zeros(1 << 24), compression=1),
        lambda: file.create_dataset(name, (_ROWS,), "f8", external=[("/etc/hostname", 0, 8 * _ROWS)]),
        lambda: file.create_virtual_dataset(name, layout),
        lambda: file.__setitem__(name, h5py.ExternalLink("/etc/hostname", "/x")),
        lambda: file.__setitem__(name, h5py.SoftLink(f"/{name}")),
        lambda: file.create_group(f"{name}/a").__setitem__("loop", file["/"]),
        lambda: file.create_dataset(name, data=np.arange(_ROWS).astype("f2")),
        lambda: file.create_dataset(name, data=np.array([b"x"] * 9)),
        lambda: file.create_dataset(name, data=["é"] * 9),
        lambda: file.create_dataset(name, data=np.zeros(9, [("a", "f8"), ("b", "i4")])),
        lambda: file.create_dataset(name, data=h5py.Empty("f8")),
        lambda: file.create_dataset(name, (0, 5), "f8", maxshape=(None, 5)),
        lambda: file.create_dataset(name, data=np.full((3, _ROWS), np.nan)),
        lambda: file.create_dataset(name, data=np.full(_ROWS, 1e-300) * np.arange(_ROWS)),
        lambda: file.create_dataset(name, data=np.full(_ROWS, 1e300) * np.arange(_ROWS)),
    ))()  # fmt: skip


@cache
def _bomb() -> bytes:
    """Return rows that need more than the memory limit of `judge`, gzipped."""
    return gzip.compress(b"t,gz\n" + b"1.0,2\n" * 20_000_000, 1)


@cache
def _noise() -> np.ndarray:
    return np.random.default_rng(1).normal(0.0, 0.01, (_ROWS, 7))


@cache
def _arrays() -> list[bytes]:
    changed = []
    for array in (
        _noise()[:, 0],
        np.asfortranarray(_noise()),
        _noise().astype("<f4"),
        (1e3 * _noise()).astype(">i2"),
    ):
        out = io.BytesIO()
        np.save(out, array)
        changed.append(out.getvalue())
    return changed


@cache
def _matlab() -> list[bytes]:
    changed = []
    content = {
        "gz": _noise()[:, 0],
        "s": {"t": np.arange(_ROWS) / 100, "name": "x"},
        "c": np.array([1, "a"], object),
    }
    for form, packed, values in (
        ("4", False, {"gz": _noise()[:, 0]}),
        ("5", False, content),
        ("5", True, content),
    ):
        out = io.BytesIO()
        scipy.io.savemat(out, values, format=form, do_compression=packed)
        changed.append(out.getvalue())
    return changed


@cache
def _hdf5() -> list[bytes]:
    changed = []
    with tempfile.TemporaryDirectory(prefix="hubodo-fuzz-") as folder:
        for version in ("earliest", "latest"):
            path = Path(folder) / f"{version}.h5"
            with h5py.File(path, "w", libver=version) as file:
                file["gz"] = _noise()[:, 0]
                file["gz"].attrs["units"] = "rad/s"
                file.create_dataset("imu/gyro", data=_noise(), chunks=(50, 7), compression=4, shuffle=True)
                file.create_dataset("imu/acc", data=_noise(), chunks=(50, 7), fletcher32=True)
            changed.append(path.read_bytes())
    return changed


@cache
def _texts() -> list[str]:
    rows = np.column_stack([np.arange(_ROWS) / 100, _noise()[:, 1:]])
    lines = [[repr(float(value)) for value in row] for row in rows]
    header = ["t", "gx", "gy", "gz", "ax", "ay", "az"]
    return [
        "\n".join(mark.join(row) for row in ([header, *lines] if named else lines)) + "\n"
        for mark, named in ((",", True), (";", True), ("\t", False), (",", False))
    ]
