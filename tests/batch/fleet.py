"""Thousands of logs through `hubodo batch`: time, speed-up by a second worker, index of a year; not a test.

    python tests/batch/fleet.py [--logs 2000] [--seconds 300] [--folder FOLDER]

Two nodes at 100 Hz; one log in a hundred has a gap, one in four hundred is broken. The real command is run;
times are wall time and processor time of all its processes. Scaling: `allan` on some logs, with one and two
workers in turn; `busy` is the share of time in which workers worked. A year is 24,000 logs of five minutes:
the rows of the index repeated with other names and times.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from batch.fleet_logs import FleetLog, cut, write
from hubodo.fleet.engine import connect_client
from script_arguments import script_parser

VEHICLES, BROKEN_EVERY, GAP_EVERY = 40, 400, 100
SCALING_LOGS, TURNS = 600, 3
YEAR_LOGS = 24_000


def write_log(place):
    """Write one log. place: folder, number, seconds."""
    folder, number, seconds = place
    vehicle, day = f"van-{number % VEHICLES:02}", number // VEHICLES * 7.0 + number % 7
    log = FleetLog(
        vehicle,
        day,
        seconds,
        bias=0.01 + 1e-3 * (number % VEHICLES),
        missing=150 if number % GAP_EVERY == 7 else 0,
        seed=number,
        nodes=("left", "right"),
    )
    (cut if number % BROKEN_EVERY == 11 else write)(folder, log)


def hubodo(*words):
    """Return the --json output of a command, its wall time and its processor time with children, s."""
    before, began = os.times(), time.monotonic()
    command = [sys.executable, "-m", "hubodo", *map(str, words), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    wall, after = time.monotonic() - began, os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return json.loads(done.stdout), wall, cpu


def measure_info(folder, out):
    """Run `info` on all logs, twice."""
    done, wall, cpu = hubodo("batch", "info", folder, "-o", out, "--workers", 2)
    size, count = done["size_bytes"], done["logs"]
    print(f"info, {count} logs, {size / 1e9:.2f} GB, 2 workers: {wall:.0f} s, {count / wall:.1f} logs/s")
    print(f"  {done['done']} done, {done['refused']} refused, {done['failed']} failed")
    print(
        f"  processor a log: {1e3 * done['cpu_s'] / count:.0f} ms of work, {1e3 * cpu / count:.0f} ms in all"
    )
    print(f"  {_work_time(out) / wall:.2f} of 2 workers at work on average, start and page among it")
    again, wall, cpu = hubodo("batch", "info", folder, "-o", out, "--workers", 2)
    print(f"info again: {again['fresh']} done, {wall:.1f} s, {cpu:.1f} s of processor")


def measure_scaling(folder, scratch):
    """Measure the speed-up of `allan` with a second worker."""
    vehicles = sorted(folder.iterdir())
    chosen = [path for vehicle in vehicles for path in sorted(vehicle.iterdir())][:SCALING_LOGS]
    rates = {1: [], 2: []}
    busy = {1: [], 2: []}
    for turn in range(TURNS):
        for workers in rates:
            out = scratch / f"scaling-{turn}-{workers}"
            _, wall, _ = hubodo("batch", "allan", *chosen, "--node", "all", "-o", out, "--workers", workers)
            rates[workers].append(len(chosen) / wall)
            busy[workers].append(_work_time(out) / (workers * wall))
    one, two = (statistics.median(rates[workers]) for workers in (1, 2))
    print(f"allan, {len(chosen)} logs, 1 and 2 workers: {one:.2f}, {two:.2f} logs/s: {two / one:.2f} times")
    print(f"  busy: {statistics.median(busy[1]):.2f}, {statistics.median(busy[2]):.2f} of the time")


def _work_time(out):
    """Return the time that workers spent on logs, s."""
    return sum(pd.read_parquet(path, columns=["wall"]).wall.sum() for path in (out / "finished").iterdir())


def measure_year(out, scratch):
    """Measure listing, searching and summarising."""
    index = scratch / "year"
    (index / "finished").mkdir(parents=True)
    rows = pa.concat_tables(pq.read_table(path) for path in (out / "finished").iterdir()).to_pandas()
    table = pd.read_parquet(out / "table.parquet")
    times = -(-YEAR_LOGS // len(rows))
    pq.write_table(pa.Table.from_pandas(_repeat_logs(rows, times)), index / "finished" / "0.parquet")
    pq.write_table(pa.Table.from_pandas(_repeat_logs(table, times)), index / "table.parquet")
    size = sum(path.stat().st_size for path in index.rglob("*.parquet"))
    for words in ((), ("--from", "2026-07-01", "--to", "2026-07-31"), ("--search", "not explained")):
        summary, wall, cpu = hubodo("logs", index, *words)
        print(
            f"logs of {len(rows) * times}, index {size / 1e6:.0f} MB, {' '.join(words) or 'all'}: "
            f"{summary['logs']} logs, {summary['hours']:.0f} h, {summary['gaps']} gaps in {wall:.1f} s, "
            f"{cpu:.1f} s of processor"
        )
    most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3
    print(f"the largest process had {most:.0f} MB")


def _repeat_logs(frame, times):
    shifted_rows = []
    for number in range(times):
        shifted = frame.assign(log=frame.log + f".{number}", vehicle="van-00")
        shifted["start"] = frame.start + pd.Timedelta(minutes=7 * number)
        shifted_rows.append(shifted)
    return pd.concat(shifted_rows, ignore_index=True)


def main():
    parser = script_parser(__doc__, logs=2000)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--folder", type=Path, help="keeps logs and results (default: a temporary folder)")
    args = parser.parse_args()
    with contextlib.ExitStack() as stack:
        scratch = args.folder or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="fleet-")))
        folder, out = scratch / "logs", scratch / "out"
        began = time.monotonic()
        with connect_client(None, 2, "auto") as client:
            client.gather(client.map(write_log, [(folder, k, args.seconds) for k in range(args.logs)]))
        print(f"{args.logs} logs of {args.seconds:g} s made in {time.monotonic() - began:.0f} s")
        measure_info(folder, out)
        measure_scaling(folder, scratch)
        measure_year(out, scratch)


if __name__ == "__main__":
    main()
