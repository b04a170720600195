"""Hours of recording in virtual time: memory per hour, its slope, and completeness of the samples.

    python tests/soak/soak.py [--hours 3] [--nodes 4] [--rate 416] [--batch 16]
        [--outage 0] [--no-odometry] [--no-web] [--one-log] [--trace]

Four nodes on the path that `hubodo record` runs, two of them wheels with live odometry; logs are cut each
hour under a disk budget; another process follows the live page and reads the metrics. Only ports and the
clock are replaced. With --outage S the last node has no power for S seconds of each hour. Exit code 1 where a
sample is missing, nothing could be followed, or memory grows by more than 0.1 MB an hour after the first hour
(1 MB in runs of less than eight hours, while bounded buffers fill).
"""

import argparse
import gc
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
import tracemalloc
from contextlib import ExitStack
from pathlib import Path
from typing import Self

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from rich.console import Console

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fakes.steady_computer import SteadyComputer, SteadyNode
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.take_snapshot import memory_in_use
from hubodo.vehicle import NodeMount, Vehicle
from hubodo.web.address import Address
from hubodo.web.config import Site
from hubodo.web.live import live_audience

LIMIT_MB, LIMIT_OF_SHORT_MB, SHORT_H = 0.1, 1.0, 8.0
VEHICLE = Vehicle(0.3, 0.9, {"left": NodeMount("left", "left"), "right": NodeMount("right", "left")})
LABELS = ("left", "right", "frame", "spare")
FOLLOWER = Path(__file__).with_name("follower.py")


class Hours:
    """Memory in MB of each hour of virtual time (the median of its minutes), printed as the run proceeds.

    A single minute scatters by 2 MB, which the allocator holds while a log is closed or a page is sent.
    """

    def __init__(self, trace: bool) -> None:
        self.memory: list[float] = []
        self._minutes: list[float] = []
        self._began, self._before = time.process_time(), None
        if trace:
            tracemalloc.start()

    def passed(self, hour: float) -> None:
        self._minutes.append((memory_in_use() or 0) / 1e6)
        if len(self._minutes) < 60:
            return
        gc.collect()
        self.memory.append(float(np.median(self._minutes)))
        self._minutes.clear()
        seconds = time.process_time() - self._began
        print(f"{hour:5.0f} h  {self.memory[-1]:7.2f} MB  {seconds:7.0f} s of processor", flush=True)
        if tracemalloc.is_tracing():
            now = tracemalloc.take_snapshot()
            for line in now.compare_to(self._before, "lineno")[:12] if self._before else ():
                print("       ", line)
            self._before = now

    def slope(self) -> float:
        """Return the slope of the memory after the first hour, MB per hour."""
        later = self.memory[1:]
        return float(np.polyfit(np.arange(len(later)), later, 1)[0]) if len(later) > 1 else 0.0


class Follower:
    """A process that reads the live page and the metrics; frames, readings: their numbers."""

    def __init__(self, page: int, metrics: int) -> None:
        """Start the process with the ports of page and metrics."""
        self.frames = self.readings = 0
        words = [sys.executable, str(FOLLOWER), str(page), str(metrics)]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        counts = self._process.communicate()[0].split()
        self.frames, self.readings = map(int, counts or (0, 0))


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=3.0)
    parser.add_argument("--nodes", type=int, default=4)
    parser.add_argument("--rate", type=float, default=416.0)
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--outage", type=float, default=0.0, help="seconds of each hour, the last node")
    parser.add_argument("--no-odometry", action="store_true")
    parser.add_argument("--no-web", action="store_true", help="neither live page nor metrics, nobody follows")
    parser.add_argument("--one-log", action="store_true", help="do not rotate")
    parser.add_argument("--trace", action="store_true", help="where memory grows; slow")
    return parser.parse_args()


def main() -> int:
    args = arguments()
    hours = Hours(args.trace)
    labels = [*LABELS, *(f"n{k}" for k in range(4, args.nodes))][: args.nodes]
    nodes = {label: SteadyNode(k + 1, args.rate, args.batch, ppm=20.0 * k) for k, label in enumerate(labels)}
    if args.outage:
        starts = np.arange(min(1800.0, args.hours * 1800), args.hours * 3600, 3600.0)
        nodes[labels[-1]].outages = tuple((start, start + args.outage) for start in starts.tolist())
    computer = SteadyComputer(nodes, hours.passed)
    metrics = free_port()
    config = RecordConfig(
        metrics=None if args.no_web else f"127.0.0.1:{metrics}",
        ports=tuple(f"{label}=/dev/{label}" for label in labels),
        duration=args.hours * 3600 + 1,
        rotate_after=None if args.one_log else 3600.0,
        disk_budget_mb=None if args.one_log else 1500.0,
    )
    page = follower = None
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hubodo-soak-")))
        nowhere = stack.enter_context(Path(os.devnull).open("w"))
        if not args.no_web:
            page = stack.enter_context(
                live_audience(Site(Address("127.0.0.1", 0)), None, folder, vehicle=VEHICLE)
            )
            port = int(re.search(r":(\d+)/", page.startup_lines[0])[1])
            follower = stack.enter_context(Follower(port, metrics))
        result = record(
            config,
            folder / "soak.mcap",
            vehicle=None if args.no_odometry else VEHICLE,
            computer=computer,
            console=Console(file=nowhere),
            audience=page,
        )
    sent = sum(node.sent for node in nodes.values())
    recorded = sum(node["samples"] for node in result.nodes.values())
    lost = sum(node["samples_lost"] for node in result.nodes.values())
    print(f"{args.hours:g} h, {len(labels)} nodes at {args.rate:g} Hz, {args.batch} a batch: {sent} samples")
    print(
        f"{recorded} recorded, {lost} lost, {result.messages_lost} messages in no log; "
        f"{len(result.files)} logs, {result.removed} of them removed"
    )
    if args.outage:
        restarts = result.nodes[labels[-1]]["restarts"]
        print(f"{labels[-1]} was off for {args.outage:g} s of each hour: {restarts} restarts")
    if follower is not None:
        print(f"another process got {follower.frames} frames of the page and {follower.readings} of metrics")
    print(f"memory grows by {hours.slope():+.2f} MB an hour after the first")
    unfollowed = follower is not None and not (follower.frames and follower.readings)
    limit = LIMIT_MB if args.hours >= SHORT_H else LIMIT_OF_SHORT_MB
    return int(recorded != sent or lost > 0 or result.failed or unfollowed or hours.slope() > limit)


if __name__ == "__main__":
    sys.exit(main())
