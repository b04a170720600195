"""Import of a CSV folder beside pandas and the `mcap` package: two wheels at 100 Hz, three lengths.

    python tests/bench/bench_import.py [--seconds 36] [--rounds 5]

Ours is what `hubodo import` runs: each file is checked (numbers, increasing times, complete rows), and all
tables are interleaved by time. The peer reads with `pandas.read_csv`, checks nothing and writes the same Imu
messages with `mcap`'s writer, one file after the other; numpy encodes their bytes at once. Processor time.
"""

import json
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas
from arguments import parse_arguments
from mcap.writer import CompressionType, Writer
from speedups import record_speedup

from hubodo.log import cdr_layouts, ros2
from hubodo.log.csv_folder import read_folder
from hubodo.log.recording_writer import write_recording

COLUMNS = ("t", "gx", "gy", "gz", "ax", "ay", "az")
AIM = 0.5


def make(folder, seconds, seed):
    """Write the folder and return the number of rows."""
    rng, count = np.random.default_rng(seed), int(seconds * 100)
    for name in ("left", "right"):
        values = rng.normal(size=(count, 6)).round(6)
        table = dict(zip(COLUMNS, (np.arange(count) / 100, *values.T), strict=True))
        pandas.DataFrame(table).to_csv(folder / f"{name}.csv", index=False)
    return 2 * count


def ours(folder, path):
    write_recording(read_folder(folder), path)


def peer(folder, path):
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start("ros2", "peer")
        schema = writer.register_schema(ros2.IMU, "ros2msg", ros2.definition(ros2.IMU).encode())
        for file in sorted(folder.glob("*.csv")):
            table = pandas.read_csv(file)
            channel = writer.register_channel(f"/{file.stem}/imu", "cdr", schema)
            layout = cdr_layouts.stamped_layout(ros2.IMU, file.stem)
            rows = np.zeros(len(table), layout.dtype)
            rows[:] = layout.template
            rows["angular_velocity"] = table[list(COLUMNS[1:4])].to_numpy()
            rows["linear_acceleration"] = table[list(COLUMNS[4:])].to_numpy()
            t_ns = np.round(table["t"].to_numpy() * 1e9).astype(np.int64)
            rows["header.stamp.sec"], rows["header.stamp.nanosec"] = np.divmod(t_ns, 1_000_000_000)
            data, size = rows.tobytes(), layout.dtype.itemsize
            for i, at in enumerate(t_ns.tolist()):
                writer.add_message(channel, at, data[i * size : (i + 1) * size], at)
        writer.finish()


def bench(seconds, rounds, seed):
    """Return one result per length: rows and seconds of both."""
    results = []
    for times in (1, 10, 100):
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place) / "csv"
            folder.mkdir()
            rows, took = make(folder, seconds * times, seed), {"hubodo": [], "pandas and mcap": []}
            for _ in range(rounds if times < 100 else 3):
                for name, job in (("hubodo", ours), ("pandas and mcap", peer)):
                    path, began = Path(place) / "made.mcap", time.process_time()
                    job(folder, path)
                    took[name].append(time.process_time() - began)
                    path.unlink()
        each = [b / a for a, b in zip(took["hubodo"], took["pandas and mcap"], strict=True)]
        record_speedup(f"importing {rows} rows of CSV: pandas and mcap", each)
        results.append({"rows": rows, **{name: statistics.median(some) for name, some in took.items()}})
    return results


def main():
    given = parse_arguments(__doc__, seconds=36.0)
    rows = bench(given.seconds, given.rounds, given.seed)
    if given.json:
        print(json.dumps(rows, indent=1))
        return
    print(f"a CSV folder into a log, processor time, median of {given.rounds}, seed {given.seed}")
    for row in rows:
        each = "  ".join(f"{name} {row[name] / row['rows'] * 1e6:.2f} µs" for name in row if name != "rows")
        print(f"  {row['rows']:>8} rows: {each} a row; ratio {row['hubodo'] / row['pandas and mcap']:.2f}")
    print(f"  aim: at most {AIM}")


if __name__ == "__main__":
    main()
