"""`make load`: many nodes on one recorder in real time: loss, latency and limit; not a test.

Nodes run in one process (nodes.py), the recorder in another; each node has a pseudo terminal with a buffer of
4 kB. Latency: from the writing of a frame on its line until its samples are passed to the log writer, which
writes them within half a second.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.latency import LatencyHistogram
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.log.log_writer import LogWriter
from hubowire.messages import ImuBatch

FOLDER = Path(__file__).parent
LIMIT_S = 0.05


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--nodes", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--rate", type=float, default=416.0)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument(
        "--to", type=int, default=512, help="then more nodes, by half, up to so many (0: no more)"
    )
    parser.add_argument("--once", action="store_true", help="one run, printed as JSON")
    args = parser.parse_args()
    if args.once:
        print(json.dumps(run(args.nodes, args.seconds, args.rate, args.batch)))
        return 0
    busy = f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before"
    print(f"{busy}; {args.rate:g} Hz in batches of {args.batch}")
    passed = run_in_process(args.nodes, args.seconds, args)
    count = args.nodes
    while count * 3 // 2 <= args.to:
        count = count * 3 // 2
        if not run_in_process(count, 20.0, args):
            print(f"breaks at {count} nodes")
            break
    return 0 if passed else 1


def run_in_process(count: int, seconds: float, args: argparse.Namespace) -> bool:
    """Run in a process of its own and print the result; return True if nothing was lost or late."""
    words = ["--once", "--nodes", count, "--seconds", seconds, "--rate", args.rate, "--batch", args.batch]
    done = subprocess.run(
        [sys.executable, __file__, *map(str, words)], stdout=subprocess.PIPE, check=True, text=True
    )
    it: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    good = not it["lost"] and not it["undecoded"] and it["late_p99"] is not None and it["late_p99"] < LIMIT_S
    late = ", ".join(
        f"{name} {1e3 * it[f'late_{name}']:.1f} ms" for name in ("median", "p99", "worst") if it["late_p99"]
    )
    print(
        f"{count:4} nodes, {seconds:.0f} s: {it['frames']} frames decoded, {it['undecoded']} kept raw alone, "
        f"{it['lost']} lost (no room on the line: {it['refused']}); {late} late; "
        f"recorder {it['cpu']:.2f} of a core, {it['memory']:.0f} MB; "
        f"{'held' if good else 'NOT HELD'}",
        flush=True,
    )
    return good


def run(count: int, seconds: float, rate: float, batch: int) -> dict[str, Any]:
    """Run one recording of `count` nodes."""
    words = [sys.executable, str(FOLDER / "nodes.py"), str(count), str(rate), str(batch)]
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 8192), hard))
    late, stop = LatencyHistogram(), threading.Event()
    written, write_raw_original, period_ns = LogWriter.write_imu, LogWriter.write_raw_frame, round(1e9 / rate)
    is_batch: list[bool] = []
    # Samples of the first half second are held for clock synchronisation.
    settled = time.monotonic() + 4.0

    def write_imu(log: LogWriter, node: str, t_pub_ns: Any, t_log_ns: Any, gyro: Any, accel: Any) -> None:
        written(log, node, t_pub_ns, t_log_ns, gyro, accel)
        if time.monotonic() > settled:
            late.add(time.time_ns() - int(np.asarray(t_pub_ns).reshape(-1)[-1]) - period_ns)

    def write_raw_frame(log: LogWriter, link: str, t_log_ns: int, frame: bytes) -> None:
        write_raw_original(log, link, t_log_ns, frame)
        is_batch.append(frame[1] == ImuBatch.type_id)

    LogWriter.write_imu, LogWriter.write_raw_frame = write_imu, write_raw_frame  # type: ignore[method-assign]
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as nodes,
    ):
        assert nodes.stdin is not None and nodes.stdout is not None
        paths = json.loads(nodes.stdout.readline())
        ports = tuple(f"n{place}={path}" for place, path in enumerate(paths))
        config = RecordConfig(ports=ports, duration=seconds + 1.0)
        start = threading.Timer(0.5, lambda: print("go", file=nodes.stdin, flush=True))
        end = threading.Timer(0.5 + seconds, nodes.stdin.close)
        before = resource.getrusage(resource.RUSAGE_SELF)
        start.start()
        end.start()
        result = record(config, Path(folder) / "load.mcap", stop=stop, console=Console(file=io.StringIO()))
        after = resource.getrusage(resource.RUSAGE_SELF)
        output = json.loads(nodes.stdout.readline())
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    result = result.as_json()
    frames = sum(node["samples"] for node in result["nodes"].values()) // batch
    return {
        "frames": frames,
        "lost": output["batches"] - sum(is_batch),
        "undecoded": sum(is_batch) - frames,
        "refused": output["refused"],
        "late_median": late.quantile(0.5),
        "late_p99": late.quantile(0.99),
        "late_worst": late.maximum,
        "cpu": cpu / seconds,
        "memory": after.ru_maxrss / 1024,
    }


if __name__ == "__main__":
    sys.exit(main())
