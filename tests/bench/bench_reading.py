"""Reading a log into arrays beside the `mcap` package: the same file, processor time, three sizes.

    python tests/bench/bench_reading.py [--seconds 60] [--rounds 5]

The log is that of a recorder: a node at 208 Hz with a temperature every sixteen samples. "mcap" iterates over
the messages with `make_reader` and unpacks stamp, rates and forces of each by `struct`, the fastest way that
the package offers; "mcap-ros2" lets its decoder create objects first. Both end in the same arrays as ours.
"""

import json
import statistics
import struct
import tempfile
import time
from pathlib import Path

import numpy as np
from arguments import parse_arguments
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from speedups import record_speedup

from hubodo.log.log_writer import LogWriter
from hubodo.log.recording_reader import read_recording

RATE_HZ, BATCH = 208.0, 16
AIM = 40.0
_STAMP = struct.Struct("<iI")


def make(path, seconds, seed):
    """Write a log of that length and return the number of samples."""
    rng, count = np.random.default_rng(seed), int(seconds * RATE_HZ) // BATCH * BATCH
    t_ns = 1_700_000_000_000_000_000 + np.round(np.arange(count) / RATE_HZ * 1e9).astype(np.int64)
    gyro = np.round(rng.normal(size=(count, 3)) / 0.00122) * 0.00122
    accel = np.round(rng.normal(size=(count, 3)) / 0.00479) * 0.00479
    with LogWriter(path, t_zero_ns=int(t_ns[0]), clock=None) as log:
        for first in range(0, count, BATCH):
            rows = slice(first, first + BATCH)
            log.write_imu("left", t_ns[rows], int(t_ns[first]), gyro[rows], accel[rows])
            log.write_temperature("left", t_ns[first : first + 1], int(t_ns[first]), [25.0])
    return count


def ours(path):
    table = read_recording(path).nodes["left"]
    return table.t, np.column_stack([table[name] for name in ("gx", "gy", "gz", "ax", "ay", "az")])


def by_struct(path):
    """Encapsulation, stamp, frame id, orientation with its covariance; then rates and forces."""
    t, rows = [], []
    with path.open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=["/left/imu"]):
            seconds, nanoseconds = _STAMP.unpack_from(message.data, 4)
            t.append(seconds * 1_000_000_000 + nanoseconds)
            body = 4 + (12 + len(b"left\0") + 7) // 8 * 8 + 13 * 8
            rows.append(
                struct.unpack_from("<3d", message.data, body)
                + struct.unpack_from("<3d", message.data, body + 96)
            )
    return (np.array(t) - t[0]) * 1e-9, np.array(rows)


def by_objects(path):
    t, rows = [], []
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, _, _, message in reader.iter_decoded_messages(topics=["/left/imu"]):
            rate, force, stamp = message.angular_velocity, message.linear_acceleration, message.header.stamp
            t.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
            rows.append((rate.x, rate.y, rate.z, force.x, force.y, force.z))
    return (np.array(t) - t[0]) * 1e-9, np.array(rows)


def timed(read, path):
    began = time.process_time()
    values = read(path)
    return time.process_time() - began, values


def bench(seconds, rounds, seed):
    """Return one result per size: samples, seconds of each reader, speed-ups."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for times in (1, 10, 100):
            path = Path(folder) / f"{times}.mcap"
            count = make(path, seconds * times, seed)
            readers = {"hubodo": ours, "mcap": by_struct}
            if times < 100:
                readers["mcap-ros2"] = by_objects
            took = {name: [] for name in readers}
            for _ in range(rounds if times < 100 else 3):
                results = {}
                for name, read in readers.items():
                    spent, results[name] = timed(read, path)
                    took[name].append(spent)
            for name, (t, values) in results.items():
                assert np.array_equal(values, results["hubodo"][1]), name
                assert np.allclose(t, results["hubodo"][0], rtol=0, atol=1e-9), name
            for name in readers:
                if name != "hubodo":
                    own = took["hubodo"]
                    each = [other / mine for other, mine in zip(took[name], own, strict=True)]
                    record_speedup(f"reading {count} samples: {name}", each)
            rows.append({"samples": count, **{name: statistics.median(some) for name, some in took.items()}})
    return rows


def main():
    given = parse_arguments(__doc__, seconds=60.0)
    rows = bench(given.seconds, given.rounds, given.seed)
    if given.json:
        print(json.dumps(rows, indent=1))
        return
    print(f"reading a log into arrays, processor time a sample, median of {given.rounds}, seed {given.seed}")
    for row in rows:
        each = {name: row[name] / row["samples"] * 1e6 for name in row if name != "samples"}
        cells = "".join(
            f"  {name} {spent:.3f} µs ({spent / each['hubodo']:.1f} times)" for name, spent in each.items()
        )
        print(f"  {row['samples']:>9} samples{cells}")
    print(f"  aim: mcap {AIM:.0f} times as long")


if __name__ == "__main__":
    main()
