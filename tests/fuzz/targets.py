"""What is fuzzed: an input made from chance, the verbs that get it, and what must hold whatever it is.

Each target makes a `Case` from a random source; `judge` runs it. A command ends with 0, 1 or 2 and at most
one line of error, which never speaks of a defect of hubodo; one that fails leaves nothing behind.
"""

from __future__ import annotations

import random
import shutil
import signal
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from fuzz import seeds
from fuzz.mutate_bag import mutated_database, mutated_rosbag1, packed_database
from fuzz.mutate_mcap import mutated, torn
from fuzz.mutate_text import mutated_csv, mutated_toml
from hubodo.ingest.link.link import Chunk, LinkLost, LinkUp
from hubodo.ingest.live.recorder import Recorder
from hubodo.log.mcap import read_recording
from hubodo.log.writer import McapLog
from hubodo.vehicle import load_vehicle
from in_process import Done, hubodo

LONGEST_S = 60
"""A case that takes longer hangs."""


@dataclass(frozen=True)
class Case:
    """An input: files by name, beside each other, and the command, in which FOLDER stands for theirs."""

    words: tuple[str, ...]
    files: dict[str, bytes]


class Found(AssertionError):
    """A case that breaks what must hold."""


def judge(case: Case) -> Done:
    """Runs a case in a folder of its own. Raises Found."""
    with tempfile.TemporaryDirectory(prefix="hubodo-fuzz-") as name, patience(case):
        folder = Path(name)
        for path, content in case.files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
        before = {path for path in folder.rglob("*") if path.is_file()}
        if case.words[0] == "frames":
            _receive(case, folder)
            return Done(0, "", "")
        words = [word.replace("FOLDER", name) for word in case.words]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            done = hubodo(*words)
        said = done.err.strip().splitlines()
        if done.code not in (0, 1, 2) or "defect of hubodo" in done.err or "Traceback" in done.err:
            raise Found(f"{' '.join(case.words)}: {done.err}")
        errors = [line for line in said if line.startswith("hubodo") and ": warning: " not in line]
        if done.code and len(errors) != 1:
            raise Found(f"{' '.join(case.words)}: code {done.code}, said {said}")
        left = {path for path in folder.rglob("*") if path.is_file()} - before
        if done.code and left:
            raise Found(f"{' '.join(case.words)}: failed, and left {sorted(map(str, left))}")
        return done


@contextmanager
def patience(case: Case) -> Iterator[None]:
    """Ends a case that hangs."""

    def late(*_: object) -> None:
        raise Found(f"{' '.join(case.words)}: takes more than {LONGEST_S} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(LONGEST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


READERS: tuple[tuple[str, ...], ...] = (
    ("info", "LOG", "--json"),
    ("info", "LOG"),
    ("export", "LOG", "-o", "FOLDER/out"),
    ("fuse", "LOG", "--vehicle", "FOLDER/v.toml", "-o", "FOLDER/out"),
    ("fuse", "LOG", "--vehicle", "FOLDER/v.toml", "-o", "FOLDER/out", "--smooth"),
    ("fuse", "LOG", "--vehicle", "FOLDER/v.toml", "-o", "FOLDER/out", "--method", "differential"),
    ("allan", "LOG", "--node", "left", "--channel", "gz", "--as-is", "--trust-units", "--json"),
    ("allan", "LOG", "--node", "left", "--channel", "gz", "--trust-still", "--trust-units"),
    ("warmup", "LOG", "--node", "left", "--channel", "gz", "--trust-still", "--trust-units"),
    ("heading", "LOG", "--node", "left", "--axis", "y", "-o", "FOLDER/h.csv"),
    ("calibrate", "wheels", "LOG", "--vehicle", "FOLDER/v.toml", "-o", "FOLDER/c.toml"),
    ("calibrate", "imu", "LOG", "--node", "left", "-o", "FOLDER/c.toml"),
    ("north", "LOG", "--node", "left", "--axis", "x", "--latitude-deg", "47"),
    ("play", "LOG", "--speed", "0"),
    ("gap", "FOLDER/m.toml", "LOG", "-o", "FOLDER/out"),
    ("report", "LOG", "-o", "FOLDER/r.html"),
    ("simulate", "FOLDER/m.toml", "--drive", "reference", "--from", "LOG", "-o", "FOLDER/s.mcap"),
    ("simulate", "FOLDER/m.toml", "--drive", "gnss", "--from", "LOG", "-o", "FOLDER/s.mcap"),
)
"""The verbs that read a log; the quick ones come more often."""
OFTEN = 6

SETTINGS = {"m.toml": seeds.MODEL.encode(), "v.toml": seeds.VEHICLE.encode()}


@cache
def unchanged() -> dict[str, bytes]:
    """Files that are beside the changed one, by name."""
    return {**SETTINGS, **{f"log/{name}": text.encode() for name, text in drive().items()}}


def mcap_case(rng: random.Random) -> Case:
    """A log of ours, or another writer's, changed."""
    data = mutated(rng, rng.choice(_logs()))
    words = rng.choice((
        *READERS[:3] * 2, *READERS, ("export", "LOG", "--format", "rosbag2", "-o", "FOLDER/out"),
        ("recover", "LOG", "-o", "FOLDER/out.mcap"), ("import", "LOG", "-o", "FOLDER/out.mcap"),
    ))  # fmt: skip
    return Case(_at(words, "FOLDER/log.mcap"), {**SETTINGS, "log.mcap": data})


BAG_READERS = (
    ("info", "LOG", "--json"),
    ("info", "LOG"),
    ("export", "LOG", "-o", "FOLDER/out"),
    ("export", "LOG", "--format", "rosbag2", "-o", "FOLDER/out"),
    ("import", "LOG", "-o", "FOLDER/out.mcap"),
    ("report", "LOG", "-o", "FOLDER/r.html"),
)


def bag_case(rng: random.Random) -> Case:
    """A rosbag2 folder or a bag of ROS 1, changed."""
    words = rng.choice(BAG_READERS)
    if rng.random() < 0.3:
        data = mutated_rosbag1(rng, seeds.ros1_bag())
        return Case(_at(words, "FOLDER/log.bag"), {**SETTINGS, "log.bag": data})
    data, mode, suffix = seeds.bag_database(), "", ""
    if rng.random() < 0.2:
        mode, data = packed_database(rng, data)
        suffix = ".zstd" if mode == "FILE" else ""
    else:
        data = mutated_database(rng, data)
    metadata = seeds.BAG_METADATA.format(mode=mode, form="zstd" if mode else "").encode()
    if rng.random() < 0.1:
        metadata = bytes(torn(rng, metadata))
    files = {f"bag/bag_0.db3{suffix}": data, "bag/metadata.yaml": metadata}
    return Case(_at(words, "FOLDER/bag"), {**SETTINGS, **files})


def csv_case(rng: random.Random) -> Case:
    """A CSV folder of which one file is changed, or a file of numbers."""
    files = {name: text for name, text in unchanged().items() if name.startswith("log/")}
    name = rng.choice(list(files))
    files[name] = mutated_csv(rng, drive()[name[4:]])
    if rng.random() < 0.2:
        words = ("allan", f"FOLDER/{name}", "--unit", "rad/s", "--channel", "gz", "--as-is", "--trust-units")
        return Case(words, files)
    words = rng.choice((
        ("import", "LOG", "-o", "FOLDER/out.mcap"), ("import", "LOG", "--repair", "-o", "FOLDER/out.mcap"),
        *READERS[:OFTEN], *READERS,
    ))  # fmt: skip
    return Case(_at(words, "FOLDER/log"), {**SETTINGS, **files})


def toml_case(rng: random.Random) -> Case:
    """A model, vehicle or calibration file changed."""
    files = {name: text for name, text in unchanged().items() if name.startswith("log/")}
    kind = rng.choice(("m.toml", "v.toml", "c.toml", "h.toml", "d.toml"))
    source = {
        "m.toml": seeds.MODEL, "v.toml": seeds.VEHICLE, "c.toml": seeds.CALIBRATION, "h.toml": seeds.RECORD,
        "d.toml": seeds.DATASHEET,
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
        "h.toml": (("record", "FOLDER/tty", "--config", "FOLDER/h.toml", "-o", "FOLDER/r.mcap"),),
        "d.toml": (
            ("allan", "FOLDER/log", "--node", "left", "--as-is", "--trust-units",
             "--datasheet", "FOLDER/d.toml"),
        ),
    }[kind]  # fmt: skip
    return Case(rng.choice(words), files)


def frames_case(rng: random.Random) -> Case:
    """A node's stream changed on the way: bytes, wild fields under right checksums, another order."""
    wires = [wire for _, wire in seeds.node_frames()]
    for _ in range(rng.randint(1, 12)):
        at = rng.randrange(len(wires))
        way = rng.randrange(6)
        if way == 0:
            wires[at] = seeds.wild_frame(rng)
        elif way == 1:
            wires[at] = seeds.bent_frame(rng, wires[at])
        elif way == 2:
            other = rng.randrange(len(wires))
            wires[at], wires[other] = wires[other], wires[at]
        elif way == 3:
            del wires[at : at + rng.choice((1, 3, 40))]
            wires = wires or [b"\0"]
        elif way == 4:
            wires[at] = bytes(torn(rng, wires[at]))
        else:
            wires.insert(at, rng.choice((b"\0" * 50, b"\xff" * 4000, b"$GPGGA,,*00\r\n", b">>> ", wires[at])))
    return Case(("frames", str(rng.randrange(1 << 30))), {"stream": b"".join(wires), **SETTINGS})


def nmea_case(rng: random.Random) -> Case:
    """A receiver's lines changed."""
    data = bytes(torn(rng, seeds.NMEA * 3))
    return Case(("frames", str(rng.randrange(1 << 30)), "gnss"), {"stream": data, **SETTINGS})


def option_case(rng: random.Random) -> Case:
    """A verb with a value of an option that cannot be meant."""
    files = {name: text for name, text in unchanged().items() if name.startswith("log/")}
    words = list(_at(rng.choice(READERS), "FOLDER/log"))
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
    "bag": bag_case,
    "csv": csv_case,
    "toml": toml_case,
    "frames": frames_case,
    "nmea": nmea_case,
    "options": option_case,
}


def _at(words: tuple[str, ...], log: str) -> tuple[str, ...]:
    return tuple(log if word == "LOG" else word for word in words)


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
    """A short drive of two nodes as the files of a CSV folder, every kind of file there is."""
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


def _receive(case: Case, folder: Path) -> None:
    """The stream through link, node, odometry into a log, which then reads without a complaint."""
    rng, label = random.Random(int(case.words[1])), "gnss" if "gnss" in case.words else "left"
    now = seeds.T0
    with McapLog(folder / "log.mcap", t_zero_ns=seeds.T0, clock=lambda: now) as log:
        recorder = Recorder(
            {"left": None},
            log,
            lambda link, data, to: True,
            lambda: now,
            gnss=["gnss"],
            vehicle=load_vehicle(folder / "v.toml"),
            t_zero_ns=seeds.T0,
        )
        recorder.handle(LinkUp(label, now, "/dev/x", False))
        data, at = case.files["stream"], 0
        while at < len(data):
            size = rng.choice((1, 7, 60, 500, 4096))
            recorder.handle(Chunk(label, now, data[at : at + size], ""))
            at += size
            now += rng.choice((0, 1_000_000, 40_000_000))
            if rng.random() < 0.05:
                recorder.tick(now)
            if rng.random() < 0.01:
                recorder.handle(LinkLost(label, now, "unplugged"))
                recorder.handle(LinkUp(label, now, "/dev/y", False))
        recorder.close()
    if warned := read_recording(folder / "log.mcap").warnings:
        raise Found(f"the log of a damaged stream is not whole: {warned}")
