"""Recording beside its peers: our writer, that of the `mcap` package and Foxglove's, same messages and disk.

`python tests/bench/bench_recording.py` prints a table; each figure is the median of five, of processor time.
All compress with zstd at level 1. Ours writes messages within half a second (one reading of the clock per
write); the peers hold whatever fits their chunk in memory.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import foxglove
import numpy as np
from foxglove.mcap import MCAPWriteOptions
from mcap.writer import CompressionType, Writer
from speedups import record_speedup

from hubodo.log import cdr_layouts, ros2
from hubodo.log.log_writer import LogWriter

RUNS = 5
MESSAGES = 200_000
SMALL = 48
"""Bytes of the small payload: a raw frame of two samples."""

Job = Callable[[Path], int]


def imu_peer(path: Path) -> int:
    """Write Imu messages encoded beforehand with the mcap package: only writing is measured."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start("ros2", "peer")
        schema = writer.register_schema(ros2.IMU, "ros2msg", ros2.definition(ros2.IMU).encode())
        channel = writer.register_channel("/left/imu", "cdr", schema)
        for i in range(MESSAGES):
            writer.add_message(channel, i, _ENCODED[i % len(_ENCODED)], i)
        writer.finish()
    return MESSAGES


def imu_foxglove(path: Path) -> int:
    """Write the same with foxglove-sdk, whose writer is in Rust, with as many threads as ours."""
    context = foxglove.Context()
    schema = foxglove.Schema(name=ros2.IMU, encoding="ros2msg", data=ros2.definition(ros2.IMU).encode())
    channel = foxglove.Channel("/left/imu", schema=schema, message_encoding="cdr", context=context)
    options = MCAPWriteOptions(compression_level=1, compression_threads=0)
    with foxglove.open_mcap(path, context=context, writer_options=options):
        for i in range(MESSAGES):
            channel.log(_ENCODED[i % len(_ENCODED)], log_time=i)
    return MESSAGES


def imu_ours(batch: int) -> Job:
    """Write batches from the wire with LogWriter.write_imu: encoding is measured as well."""

    def job(path: Path) -> int:
        with LogWriter(path) as log:
            for first in range(0, MESSAGES, batch):
                rows = slice(first, first + batch)
                log.write_imu("left", _T[rows], first, _GYRO[rows], _ACCEL[rows])
        return MESSAGES

    return job


def small_peer(path: Path) -> int:
    """Write payloads of 48 bytes with the mcap package."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start("ros2", "peer")
        channel = writer.register_channel("/raw", "hubodo", 0)
        for i in range(MESSAGES):
            writer.add_message(channel, i, _PAYLOADS[i % len(_PAYLOADS)], i)
        writer.finish()
    return MESSAGES


def small_single(path: Path) -> int:
    """Write one message per call with LogWriter.write."""
    with LogWriter(path) as log:
        channel = log.add_channel("/raw", "", "", b"", "hubodo")
        for i in range(MESSAGES):
            log.write(channel, i, i, _PAYLOADS[i % len(_PAYLOADS)])
    return MESSAGES


_RNG = np.random.default_rng(1)
_T = 1_700_000_000_000_000_000 + np.arange(MESSAGES) * 4_800_000
_GYRO = np.round(_RNG.normal(size=(MESSAGES, 3)) / 0.00122) * 0.00122
_ACCEL = np.round(_RNG.normal(size=(MESSAGES, 3)) / 0.00479) * 0.00479
_PAYLOADS = [row.tobytes() for row in _RNG.integers(0, 256, (1000, SMALL), np.uint8)]


def _encoded() -> list[bytes]:
    layout = cdr_layouts.stamped_layout(ros2.IMU, "left")
    rows = np.zeros(4000, layout.dtype)
    rows[:] = layout.template
    rows["angular_velocity"], rows["linear_acceleration"] = _GYRO[:4000], _ACCEL[:4000]
    return [row.tobytes() for row in rows]


_ENCODED = _encoded()


def rate(job: Job, folder: Path) -> float:
    """Return messages per second, including closing the files."""
    path = folder / "bench.mcap"
    start = time.process_time()
    count = job(path)
    seconds = time.process_time() - start
    path.unlink()
    return count / seconds


def bench(runs: int = RUNS) -> list[tuple[str, float, float]]:
    """Return (name, messages/s, ratio to the peer on the same messages), peers first; runs interleaved."""
    groups: list[dict[str, Job]] = [
        {
            "Imu: mcap Writer.add_message, encoded before": imu_peer,
            "Imu: foxglove-sdk Channel.log, encoded before": imu_foxglove,
            "Imu: hubodo, 8 a batch": imu_ours(8),
            "Imu: hubodo, 16 a batch": imu_ours(16),
            "Imu: hubodo, 2048 a batch": imu_ours(2048),
        },
        {
            "48 bytes: mcap Writer.add_message": small_peer,
            "48 bytes: hubodo write, one a call": small_single,
        },
    ]
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        for jobs in groups:
            rates: dict[str, list[float]] = {name: [] for name in jobs}
            for _ in range(runs):
                for name, job in jobs.items():
                    rates[name].append(rate(job, Path(folder)))
            medians = {name: statistics.median(own_rates) for name, own_rates in rates.items()}
            peer = next(iter(medians.values()))
            for name, own_rates in rates.items():
                for peer_name in ("mcap Writer", "foxglove-sdk"):
                    theirs = next((some for other, some in rates.items() if peer_name in other), None)
                    if "hubodo" in name and theirs is not None:
                        each = [mine / other for mine, other in zip(own_rates, theirs, strict=True)]
                        record_speedup(f"recording, {name}: {peer_name}", each)
            lines += [(name, own_rates, own_rates / peer) for name, own_rates in medians.items()]
    return lines


def main() -> None:
    """Print the table."""
    print(f"recording, median of {RUNS}: {'M msg/s':>35} {'ratio':>8}")
    for name, own_rates, ratio in bench():
        print(f"{name:<46} {own_rates / 1e6:>15.3f} {ratio:>8.2f}")


if __name__ == "__main__":
    main()
