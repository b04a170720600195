"""Print the table of all benchmark ratios to peers, and those that have become slower.

    python tests/bench/table.py [--expect]

Reads the results that `speedups.py` stored under out/bench, writes table.md and table.json there, and
compares the medians with expected.json beside this file. These are ratios to peers, which differ less
between machines than seconds do. A median below the expected one by more than its margin counts as slower:
exit code 1. --expect stores the medians of this run as the expected ones.
"""

import argparse
import json
import os
import platform
import statistics
import sys
from importlib.metadata import version
from pathlib import Path

from speedups import OUT

EXPECTED = Path(__file__).with_name("expected.json")
MARGIN = 0.35
PEERS = ("numpy", "pymavlink", "mcap", "foxglove-sdk", "allantools", "filterpy", "gtsam", "pandas")


def machine():
    """Return the machine and versions for which the figures hold."""
    versions = ", ".join(f"{name} {version(name)}" for name in PEERS)
    place = f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}"
    return f"{place}, Python {platform.python_version()}; {versions}"


def measured():
    """Return the median, smallest and largest ratio by name."""
    rows = [json.loads(file.read_text()) for file in sorted(OUT.glob("*.json")) if file.name != "table.json"]
    return {
        row["name"]: {
            "median": statistics.median(row["times"]),
            "least": min(row["times"]),
            "most": max(row["times"]),
            "rounds": len(row["times"]),
        }
        for row in rows
    }


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--expect", action="store_true")
    given = parser.parse_args()
    rows = measured()
    if given.expect:
        expected = {name: float(f"{row['median']:.3g}") for name, row in rows.items()}
        EXPECTED.write_text(json.dumps({"margin": MARGIN, "times": expected}, indent=1) + "\n")
    stored = json.loads(EXPECTED.read_text())
    lines = [
        "| work | times as fast as its peer | least to most | rounds | expected |",
        "|---|---|---|---|---|",
    ]
    slower = []
    for name, row in rows.items():
        wanted = stored["times"].get(name)
        fell = wanted is not None and row["median"] < wanted * (1 - stored["margin"])
        slower += [f"{name}: {row['median']:.3g} times instead of {wanted:.3g}"] if fell else []
        spread = f"{row['least']:.3g} to {row['most']:.3g}"
        lines.append(f"| {name} | {row['median']:.3g} | {spread} | {row['rounds']} | {wanted or ''} |")
    missing = sorted(set(stored["times"]) - set(rows))
    page = "\n".join([machine(), "", *lines, ""])
    (OUT / "table.md").write_text(page)
    (OUT / "table.json").write_text(json.dumps({"machine": machine(), "times": rows}, indent=1) + "\n")
    print(page)
    for line in slower:
        print(f"slower: {line}")
    if missing:
        print(f"not measured in this folder: {', '.join(missing)}")
    return 1 if slower else 0


if __name__ == "__main__":
    sys.exit(main())
