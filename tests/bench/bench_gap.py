"""The gap workflow on 240 s of two nodes at 100 Hz with a hidden effect, by length, and on real recordings.

python tests/bench/bench_gap.py [ROUNDS] [--minutes 10,30,60] [--only parts,lengths,recordings,watch]

Processor time and peak memory for each length and recording, each in a process of its own. Watch: a drive is
analysed every few seconds while it is recorded, with an IMU mounted off the hub.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

from gap_matrix import cases, recording
from gap_matrix.dose import MEDIUM_NATS, GainMeter
from gap_matrix.effects import Effect as HiddenEffect
from gap_runs import CAR, wheelchair_model
from hubodo.effects import BY_NAME
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.state.terms import ALL, ModelTerm
from hubodo.gap.watch import GapWatch
from hubodo.gap.workflow import find_problem_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model
from hubodo.recording import Table
from script_arguments import script_parser
from wanted import SHARED

SEED, SECONDS, HIDDEN = 5, 240.0, "wheel_camber"
MINUTES = (10, 30, 60)
FORWARD_LIMIT = 0.015  # s
WORKFLOW_LIMIT = 5.0  # s of processor time
MEMORY_LIMIT = 0.9  # GB
GROWTH_LIMIT = (
    1.1  # largest ratio of the time per minute in the longest log to that in the shortest, at equal findings
)
RECORDING_LIMIT = 100.0  # s of processor time, on a busy computer
RECORDINGS = {"wheelchair": wheelchair_model(0.92), "car/drive-1": CAR}
EVALUATIONS = 50
ARM, WATCHED, EVERY = 0.15, 60.0, 5.0  # lever arm, m; duration of the drive and interval of the analyses, s
EXPECTED_FINDING = f"left: the IMU sits {ARM:.2f} m off the hub"


def make(folder, seconds):
    """Return the log: both nodes at 100 Hz."""
    setup = cases.resample_nodes(cases.draw_setup(SEED, duration=seconds), 100.0, np.random.default_rng(SEED))
    effect, _ = GainMeter(setup).scale_to_gain(cases.draw_hidden_effect(setup, HIDDEN, "left"), MEDIUM_NATS)
    recording.write_case_files(setup, [effect], folder, {})
    return folder


def once(folder, model_file=None):
    """Return the processor time of each part in order, s, and the names found."""
    marks = [("read the CSV folder", time.process_time())]

    def mark(words, share):
        marks.append((words, time.process_time()))

    log = read_folder(folder)
    mark("bring log and model together", 0.0)
    problem = build_problem(log, read_model(model_file or folder / "model.toml"))
    del log  # As the verb does.
    result = find_problem_gap(problem, report_progress=mark)
    mark("", 1.0)
    parts = {}
    for (words, start), (_, end) in pairwise(marks):
        parts[words] = parts.get(words, 0.0) + end - start
    return parts, [finding.effect for finding in result.found]


def forward(folder):
    """Return the fastest of many evaluations at one delay, s, each with other radius, camber and arm."""
    problem = build_problem(read_folder(folder), read_model(folder / "model.toml"))
    durations = []
    for k in range(EVALUATIONS):
        effects = [
            BY_NAME["wheel_radius"](error=1e-4 * k),
            BY_NAME["wheel_camber"](angle=1e-3 * k),
            BY_NAME["lever_arm"](x=1e-4 * k, z=1e-3),
            BY_NAME["time_offset"](delay=1e-3),
        ]
        state = build_initial_state(problem).with_terms([ModelTerm(effect, ALL) for effect in effects])
        start = time.perf_counter()
        _ = state.predictions
        durations.append(time.perf_counter() - start)
    return min(durations), sum(len(node.t) for node in problem.nodes)


def measure(folder, model):
    """Print one run on a log as a line of JSON: processor seconds, peak memory in GB, findings."""
    parts, effects = once(folder, model)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(json.dumps({"seconds": sum(parts.values()), "memory": peak, "found": effects}))


def of_length(minutes):
    """Return time and memory for one log of that length."""
    with tempfile.TemporaryDirectory() as name:
        # A new process starts with the peak memory of its parent, so the parent stays small.
        own([str(minutes), "--make", name])
        return json.loads(own(["--measure", name]))


def own(words):
    """Run this program in a process of its own and return its output."""
    command = [sys.executable, __file__, *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def by_parts(rounds):
    """Print the parts of 240 s; return True if they are within their limits."""
    with tempfile.TemporaryDirectory() as name:
        folder = make(Path(name), SECONDS)
        seconds, samples = forward(folder)
        parts, effects = min(
            (once(folder) for _ in range(rounds)), key=lambda measurement: sum(measurement[0].values())
        )
    whole = sum(parts.values())
    print(f"gap workflow, {SECONDS:.0f} s, two nodes at 100 Hz, {HIDDEN} hidden (seed {SEED})")
    print(f"  processor time, best of {rounds}")
    for words, durations in parts.items():
        print(f"  {words:58} {durations:6.2f} s")
    limit = f"(at most {WORKFLOW_LIMIT:.0f})"
    print(f"  {'in all':58} {whole:6.2f} s {limit}   found: {', '.join(effects) or 'nothing'}")
    print(
        f"  one forward evaluation, {samples} samples, best of {EVALUATIONS}: {1e3 * seconds:.1f} ms "
        f"(at most {1e3 * FORWARD_LIMIT:.0f})"
    )
    return seconds <= FORWARD_LIMIT and whole <= WORKFLOW_LIMIT and effects == [HIDDEN]


def by_length(lengths):
    """Print time and memory for logs of several lengths; return True if they grow at most linearly."""
    measurement = {minutes: of_length(minutes) for minutes in lengths}
    for minutes, one in measurement.items():
        print(
            f"  {minutes:3} minutes: {one['seconds']:6.1f} s of processor, "
            f"{one['seconds'] / minutes:.2f} s a minute, {one['memory']:.2f} GB at most "
            f"(of {MEMORY_LIMIT:.1f}), found: {', '.join(one['found']) or 'nothing'}"
        )
    # A further finding takes further rounds.
    comparable = [at for at in lengths if measurement[at]["found"] == measurement[min(lengths)]["found"]]
    shortest, longest = (measurement[at]["seconds"] / at for at in (min(comparable), max(comparable)))
    print(
        f"  {max(comparable)} minutes: {longest / shortest:.2f} times as much a minute as {min(comparable)} "
        f"(at most {GROWTH_LIMIT:.1f})"
    )
    return (
        all(
            one["memory"] <= MEMORY_LIMIT and sorted(one["found"]) == sorted([HIDDEN])
            for minutes, one in measurement.items()
        )
        and longest <= GROWTH_LIMIT * shortest
    )


def on_recordings():
    """Print time for real logs with models without effects; return True if within the limits."""
    good = True
    with tempfile.TemporaryDirectory() as name:
        model = Path(name) / "model.toml"
        for where, text in RECORDINGS.items():
            folder = SHARED / "data" / where
            if not folder.is_dir():
                print(f"  {folder}: no recording there")
                continue
            model.write_text(text, "utf-8")
            one = json.loads(own(["--measure", str(folder), "--model", str(model)]))
            print(
                f"  {where}: {one['seconds']:.0f} s of processor (at most {RECORDING_LIMIT:.0f}), "
                f"{one['memory']:.2f} GB at most, {len(one['found'])} findings"
            )
            good = good and one["seconds"] <= RECORDING_LIMIT
    return good


def while_recording():
    """Print when a growing drive's effect is reported, and the time of each search."""
    with tempfile.TemporaryDirectory() as name:
        setup = cases.draw_setup(SEED, duration=WATCHED)
        hidden = HiddenEffect("lever_arm", "left", {"x": 0.8 * ARM, "y": 0.6 * ARM, "z": 0.0})
        recording.write_case_files(setup, [hidden], Path(name), {})
        log, vehicle = read_folder(Path(name)), read_model(Path(name) / "model.toml").vehicle
    watch, findings, durations = GapWatch(vehicle), [], []
    for seconds in np.arange(EVERY, WATCHED + EVERY, EVERY):
        start = time.process_time()
        findings += [
            (seconds, words)
            for words in watch.find_new_effects(replace(log, nodes=_until(log.nodes, seconds)))
        ]
        durations.append(time.process_time() - start)
    print(
        f"  while it is recorded (seed {SEED}): " + "; ".join(f"after {at:.0f} s {it}" for at, it in findings)
    )
    print(
        f"  slowest of {len(durations)} searches: {max(durations):.1f} s of processor, "
        f"all: {sum(durations):.1f} s"
    )
    return [words for _, words in findings] == [EXPECTED_FINDING]


def _until(nodes, seconds):
    return {
        name: Table({column: table[column][table.t < table.t[0] + seconds] for column in table})
        for name, table in nodes.items()
    }


def main(argv=None):
    parser = script_parser(__doc__)
    parser.add_argument("rounds", type=int, nargs="?", default=3)
    parser.add_argument(
        "--minutes", default=MINUTES, type=lambda text: tuple(int(it) for it in text.split(","))
    )
    parser.add_argument("--only", default="parts,lengths,recordings,watch")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--model", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--make", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.make is not None:
        make(args.make, 60.0 * args.rounds)
        return 0
    if args.measure is not None:
        measure(args.measure, args.model)
        return 0
    parts = {
        "parts": lambda: by_parts(args.rounds),
        "lengths": lambda: by_length(args.minutes),
        "recordings": on_recordings,
        "watch": while_recording,
    }
    good = [parts[name]() for name in args.only.split(",")]
    return not all(good)


if __name__ == "__main__":
    sys.exit(main())
