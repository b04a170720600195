"""Speed-ups over peers, stored by the benchmarks for the table at the end of `make bench`."""

import json
import re
from collections.abc import Sequence
from pathlib import Path

OUT = Path(__file__).resolve().parents[2] / "out" / "bench"


def record_speedup(name: str, times: Sequence[float]) -> None:
    """Store the ratio of a peer's time to ours in each round of one run."""
    OUT.mkdir(parents=True, exist_ok=True)
    file = OUT / (re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") + ".json")
    file.write_text(json.dumps({"name": name, "times": [float(value) for value in times]}) + "\n")
