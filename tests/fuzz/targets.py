"""The fuzzed readers, each with the function that draws a case."""

from __future__ import annotations

import random
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from fuzz import bag_cases, numbers_cases, parquet_cases, seeds
from fuzz.case import Case
from fuzz.http_cases import http_case
from fuzz.mutate_mcap import mutated, torn
from fuzz.mutate_text import mutated_csv, mutated_toml
from fuzz.nmea_cases import nmea_case
from fuzz.settings import SETTINGS
from fuzz.words import LOG_READERS, QUICK, at
from in_process import hubodo


@cache
def unchanged() -> dict[str, bytes]:
    """Return the unchanged files beside the changed one, by name."""
    return {**SETTINGS, **{f"log/{name}": text.encode() for name, text in drive().items()}}


def mcap_case(rng: random.Random) -> Case:
    """Return a changed log of hubodo or of another writer."""
    data = mutated(rng, rng.choice(_logs()))
    words = rng.choice((
        *LOG_READERS[:3] * 2, *LOG_READERS, ("export", "LOG", "--format", "rosbag2", "-o", "FOLDER/out"),
        ("recover", "LOG", "-o", "FOLDER/out.mcap"), ("import", "LOG", "-o", "FOLDER/out.mcap"),
    ))  # fmt: skip
    return Case(at(words, "FOLDER/log.mcap"), {**SETTINGS, "log.mcap": data})


def csv_case(rng: random.Random) -> Case:
    """Return a CSV folder with one changed file, or a number file."""
    files = {name: text for name, text in unchanged().items() if name.startswith("log/")}
    name = rng.choice(list(files))
    files[name] = mutated_csv(rng, drive()[name[4:]])
    if rng.random() < 0.2:
        words = ("allan", f"FOLDER/{name}", "--unit", "rad/s", "--channel", "gz", "--as-is", "--trust-units")
        return Case(words, files)
    words = rng.choice((
        ("import", "LOG", "-o", "FOLDER/out.mcap"), ("import", "LOG", "--repair", "-o", "FOLDER/out.mcap"),
        *LOG_READERS[:QUICK], *LOG_READERS,
    ))  # fmt: skip
    return Case(at(words, "FOLDER/log"), {**SETTINGS, **files})


def toml_case(rng: random.Random) -> Case:
    """Return a changed model, vehicle or calibration file."""
    files = {name: text for name, text in unchanged().items() if name.startswith("log/")}
    kind = rng.choice(("m.toml", "v.toml", "c.toml", "h.toml", "d.toml", "k.toml", "f.toml"))
    source = {
        "m.toml": seeds.MODEL, "v.toml": seeds.VEHICLE, "c.toml": seeds.CALIBRATION, "h.toml": seeds.RECORD,
        "d.toml": seeds.DATASHEET, "k.toml": seeds.KEYS, "f.toml": seeds.FLEET,
    }[kind]  # fmt: skip
    files.update(SETTINGS)
    files[kind] = mutated_toml(rng, seeds.document(source))
    fuse = ("fuse", "FOLDER/log", "--vehicle", "FOLDER/v.toml", "-o", "FOLDER/out")
    words = {
        "m.toml": (
            ("simulate", "FOLDER/m.toml", "--duration", "6", "--rate", "50", "-o", "FOLDER/s.mcap"),
            ("simulate", "FOLDER/m.toml", "--drive", "turntable", "--duration", "50", "-o", "FOLDER/s.mcap"),
            ("gap", "FOLDER/m.toml", "FOLDER/log", "-o", "FOLDER/out"),
        ),
        "v.toml": (fuse, ("calibrate", "wheels", *fuse[1:4], "-o", "FOLDER/c2.toml"),
                   ("record", "FOLDER/tty", "--vehicle", "FOLDER/v.toml", "-o", "FOLDER/r.mcap")),
        "c.toml": (
            (*fuse, "--calibration", "FOLDER/c.toml"),
            ("simulate", "FOLDER/m.toml", "--calibration", "FOLDER/c.toml", "--duration", "6",
             "-o", "FOLDER/s.mcap"),
            ("heading", "FOLDER/log", "--node", "left", "--axis", "y", "--calibration", "FOLDER/c.toml"),
            ("calibrate", "imu", "FOLDER/log", "--node", "left", "-o", "FOLDER/c.toml"),
        ),
        "h.toml": (
            ("record", "FOLDER/tty", "--config", "FOLDER/h.toml", "-o", "FOLDER/r.mcap"),
            ("config", "check", "FOLDER/h.toml"),
        ),
        "k.toml": (("record", "FOLDER/tty", "--key-file", "FOLDER/k.toml", "-o", "FOLDER/r.mcap"),),
        "f.toml": (("flash", "--all", "--fleet", "FOLDER/f.toml"),),
        "d.toml": (
            ("allan", "FOLDER/log", "--node", "left", "--as-is", "--trust-units",
             "--datasheet", "FOLDER/d.toml"),
        ),
    }[kind]  # fmt: skip
    return Case(rng.choice(words), files)


def frames_case(rng: random.Random) -> Case:
    """Return a node's stream with changed bytes, random fields with valid checksums, or another order."""
    wires = [wire for _, wire in seeds.node_frames()]
    for _ in range(rng.randint(1, 12)):
        at = rng.randrange(len(wires))
        choice = rng.randrange(6)
        if choice == 0:
            wires[at] = seeds.wild_frame(rng)
        elif choice == 1:
            wires[at] = seeds.bent_frame(rng, wires[at])
        elif choice == 2:
            other = rng.randrange(len(wires))
            wires[at], wires[other] = wires[other], wires[at]
        elif choice == 3:
            del wires[at : at + rng.choice((1, 3, 40))]
            wires = wires or [b"\0"]
        elif choice == 4:
            wires[at] = bytes(torn(rng, wires[at]))
        else:
            wires.insert(at, rng.choice((b"\0" * 50, b"\xff" * 4000, b"$GPGGA,,*00\r\n", b">>> ", wires[at])))
    return Case(("frames", str(rng.randrange(1 << 30))), {"stream": b"".join(wires), **SETTINGS})


def option_case(rng: random.Random) -> Case:
    """Return a verb with a nonsensical option value."""
    files = {name: text for name, text in unchanged().items() if name.startswith("log/")}
    words = list(at(rng.choice(LOG_READERS), "FOLDER/log"))
    if rng.random() < 0.5:
        words = ["simulate", "FOLDER/m.toml", "--duration", "6", "-o", "FOLDER/s.mcap"]
    options = {
        "simulate": ("--duration", "--rate", "--reference-rate", "--seed", "--temperature", "--settle",
                     "--supply", "--stop", "--turn", "--angles-deg", "--azimuth-deg", "--latitude-deg",
                     "--drive"),
        "fuse": ("--smooth", "--antenna", "--nodes"), "allan": ("--turn", "--start", "--end", "--per-octave"),
        "warmup": ("--age", "--at", "--start", "--end"),
        "heading": ("--age", "--rest", "--lag", "--step", "--scale-sigma"),
        "north": ("--near-deg", "--settle", "--step-deg", "--scale-sigma", "--simulate-azimuth-deg", "--stop",
                  "--stops"),
        "play": ("--start", "--end"), "report": ("--gravity",),
        "calibrate": ("--gravity", "--min-rest", "--radius-sigma", "--track-sigma"),
    }  # fmt: skip
    for option in rng.sample(options.get(words[0], ("--rate",)), k=1):
        values = rng.choice(VALUES)
        words += [option, values, *(["1"] if option in ("--antenna", "--rest", "--temperature") else [])]
    return Case(tuple(words), {**SETTINGS, **files})


VALUES = (
    "nan", "inf", "-inf", "1e308", "-1", "0", "1e-300", "1e11",
    "999999999", "", "x", "1_0", "٣", "0.001", "60",
)  # fmt: skip

TARGETS: dict[str, Callable[[random.Random], Case]] = {
    "mcap": mcap_case,
    "rosbag1": bag_cases.rosbag1_case,
    "rosbag2": bag_cases.rosbag2_case,
    "csv": csv_case,
    "parquet": lambda rng: parquet_cases.parquet_case(rng, drive()),
    "text": numbers_cases.text_case,
    "npy": numbers_cases.npy_case,
    "npz": numbers_cases.npz_case,
    "mat": numbers_cases.mat_case,
    "hdf5": numbers_cases.hdf5_case,
    "toml": toml_case,
    "frames": frames_case,
    "nmea": nmea_case,
    "options": option_case,
    "http": http_case,
}
"""By the name of the reader, as `--reader` takes it."""


@cache
def _logs() -> list[bytes]:
    folder = Path(tempfile.mkdtemp(prefix="hubodo-fuzz-"))
    try:
        ours = seeds.our_log(folder / "ours.mcap")
        (folder / "m.toml").write_text(seeds.MODEL)
        words = ("simulate", folder / "m.toml", "--duration", 5, "--rate", 10, "--reference-rate", 2)
        assert hubodo(*words, "-o", folder / "drive.mcap").code == 0
        drive = (folder / "drive.mcap").read_bytes()
    finally:
        shutil.rmtree(folder)
    foreign = [
        seeds.foreign_log(chunked=chunked, crcs=crcs) for chunked in (True, False) for crcs in (True, False)
    ]
    return [ours, ours, drive, *foreign]


@cache
def drive() -> dict[str, str]:
    """Return a short drive of two nodes as a CSV folder with every kind of file."""
    folder = Path(tempfile.mkdtemp(prefix="hubodo-fuzz-"))
    try:
        (folder / "m.toml").write_text(seeds.MODEL)
        words = ("simulate", folder / "m.toml", "--duration", 21, "--rate", 20, "--reference-rate", 10)
        assert hubodo(*words, "-o", folder / "drive").code == 0
        files = {path.name: path.read_text() for path in sorted((folder / "drive").iterdir())}
    finally:
        shutil.rmtree(folder)
    rows = range(21)
    files["gnss.csv"] = "t,latitude_deg,longitude_deg,altitude,sigma\n" + "".join(
        f"{t},{47 + 1e-6 * t},{8 + 2e-6 * t},400,1\n" for t in rows
    )
    files["wheels.csv"] = "t,left,right\n" + "".join(f"{t / 5},0.5,0.5\n" for t in range(100))
    files["heading.csv"] = "t,heading,sigma\n" + "".join(f"{t},0.1,0.05\n" for t in rows)
    files["table.csv"] = "t,angle,moving\n" + "".join(f"{t},{t // 5},{int(t % 5 == 4)}\n" for t in rows)
    return files
