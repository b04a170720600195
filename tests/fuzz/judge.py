"""Check in this process the properties that every input must satisfy.

A command ends with 0, 1 or 2 and at most one line of error, which never speaks of a defect of hubodo; one
that fails leaves nothing behind.
"""

from __future__ import annotations

import random
import signal
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fuzz import seeds
from fuzz.case import Case, Defect
from fuzz.http_cases import request
from hubodo.ingest.link.link import Chunk, LinkLost, LinkUp
from hubodo.ingest.live.recorder import Recorder
from hubodo.log.input_limits import memory_limit
from hubodo.log.log_writer import LogWriter
from hubodo.log.recording_reader import read_recording
from hubodo.vehicle import load_vehicle
from in_process import Done, hubodo

LONGEST_S = 60
"""Time after which a case counts as hanging."""
READING_BYTES = 256 << 20
"""Memory that reading one file may take: the limit of --max-memory while cases are run."""


def judge(case: Case) -> Done:
    """Run a case in a folder of its own. Raises Defect."""
    with (
        tempfile.TemporaryDirectory(prefix="hubodo-fuzz-") as name,
        time_limit(case),
        memory_limit(READING_BYTES),
    ):
        folder = Path(name)
        for path, content in case.files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
        before = {path for path in folder.rglob("*") if path.is_file()}
        if case.words[0] in ("frames", "http"):
            (_receive if case.words[0] == "frames" else request)(case, folder)
            return Done(0, "", "")
        words = [word.replace("FOLDER", name) for word in case.words]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            done = hubodo(*words)
        error_lines = done.err.strip().splitlines()
        if done.code not in (0, 1, 2) or "defect of hubodo" in done.err or "Traceback" in done.err:
            raise Defect(f"{' '.join(case.words)}: {done.err}")
        errors = [line for line in error_lines if line.startswith("hubodo") and ": warning: " not in line]
        if done.code and len(errors) != 1:
            raise Defect(f"{' '.join(case.words)}: code {done.code}, said {error_lines}")
        left = {path for path in folder.rglob("*") if path.is_file()} - before
        if done.code and left:
            raise Defect(f"{' '.join(case.words)}: failed, and left {sorted(map(str, left))}")
        return done


@contextmanager
def time_limit(case: Case) -> Iterator[None]:
    """Stop a hanging case."""

    def late(*_: object) -> None:
        raise Defect(f"{' '.join(case.words)}: takes more than {LONGEST_S} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(LONGEST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _receive(case: Case, folder: Path) -> None:
    """Pass a stream through link, node and odometry into a log that must read without warnings."""
    rng, label = random.Random(int(case.words[1])), "gnss" if "gnss" in case.words else "left"
    now = seeds.T0
    with LogWriter(folder / "log.mcap", t_zero_ns=seeds.T0, clock=lambda: now) as log:
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
        raise Defect(f"the log of a damaged stream is not whole: {warned}")
