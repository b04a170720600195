"""Hours of recording in virtual time: memory at each of them, its slope, and whether all samples came.

    python tests/soak/soak.py [--hours 3] [--nodes 4] [--rate 416] [--batch 16] [--no-odometry] [--one-log]

Four nodes on the path that `hubodo record` runs, two of them wheels with live odometry, logs cut each hour
under a budget of disk; only ports and the clock are replaced. Exit code 1 where a sample is missing or memory
grows by more than 1 MB an hour after the first hour.
"""

import argparse
import gc
import os
import sys
import tempfile
import time
import tracemalloc
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from rich.console import Console

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fakes.steady_computer import SteadyComputer, SteadyNode
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.snapshot import memory_in_use
from hubodo.vehicle import NodeMount, Vehicle

LIMIT_MB = 1.0
VEHICLE = Vehicle(0.3, 0.9, {"left": NodeMount("left", "left"), "right": NodeMount("right", "left")})
LABELS = ("left", "right", "frame", "spare")


class Hours:
    """Memory in MB at each hour of virtual time, printed as it goes."""

    def __init__(self, trace: bool) -> None:
        self.memory: list[float] = []
        self._began, self._before = time.process_time(), None
        if trace:
            tracemalloc.start()

    def passed(self, hour: float) -> None:
        gc.collect()
        self.memory.append((memory_in_use() or 0) / 1e6)
        seconds = time.process_time() - self._began
        print(f"{hour:5.0f} h  {self.memory[-1]:7.1f} MB  {seconds:7.0f} s of processor", flush=True)
        if tracemalloc.is_tracing():
            now = tracemalloc.take_snapshot()
            for line in now.compare_to(self._before, "lineno")[:12] if self._before else ():
                print("       ", line)
            self._before = now

    def slope(self) -> float:
        """MB an hour after the first."""
        later = self.memory[1:]
        return float(np.polyfit(np.arange(len(later)), later, 1)[0]) if len(later) > 1 else 0.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=3.0)
    parser.add_argument("--nodes", type=int, default=4)
    parser.add_argument("--rate", type=float, default=416.0)
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--no-odometry", action="store_true")
    parser.add_argument("--one-log", action="store_true", help="do not rotate")
    parser.add_argument("--trace", action="store_true", help="where memory grows; slow")
    args = parser.parse_args()
    hours = Hours(args.trace)
    labels = [*LABELS, *(f"n{k}" for k in range(4, args.nodes))][: args.nodes]
    nodes = {label: SteadyNode(k + 1, args.rate, args.batch, ppm=20.0 * k) for k, label in enumerate(labels)}
    computer = SteadyComputer(nodes, hours.passed)
    with tempfile.TemporaryDirectory(prefix="hubodo-soak-") as folder:
        config = RecordConfig(
            ports=tuple(f"{label}=/dev/{label}" for label in labels),
            duration=args.hours * 3600 + 1,
            rotate_after=None if args.one_log else 3600.0,
            disk_budget_mb=None if args.one_log else 1500.0,
        )
        with Path(os.devnull).open("w") as nowhere:
            result = record(
                config,
                Path(folder) / "soak.mcap",
                vehicle=None if args.no_odometry else VEHICLE,
                computer=computer,
                console=Console(file=nowhere),
            )
    sent = sum(node.sent for node in nodes.values())
    kept = sum(node["samples"] for node in result.nodes.values())
    lost = sum(node["samples_lost"] for node in result.nodes.values())
    print(f"{args.hours:g} h, {len(labels)} nodes at {args.rate:g} Hz, {args.batch} a batch: {sent} samples")
    print(
        f"{kept} recorded, {lost} lost, {result.messages_lost} messages in no log; {len(result.files)} logs"
    )
    print(f"memory grows by {hours.slope():+.2f} MB an hour after the first")
    return int(kept != sent or lost > 0 or result.failed or hours.slope() > LIMIT_MB)


if __name__ == "__main__":
    sys.exit(main())
