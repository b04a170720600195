"""Memory of a recorder in relation to the data recorded."""

import tracemalloc
from pathlib import Path

from rich.console import Console

from fakes.steady_computer import SteadyComputer, SteadyNode
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig

LABELS = ("left", "right")


def test_memory_grows_only_by_the_chunk_index(tmp_path):
    """A single log is the worst case: its index takes 275 bytes for each of two chunks per second."""
    nodes = {label: SteadyNode(k + 1, 208.0, 16, 20.0 * k) for k, label in enumerate(LABELS)}
    computer, memory = SteadyComputer(nodes), {}

    def read_memory(snapshot):
        memory[round(snapshot.seconds)] = tracemalloc.get_traced_memory()[0]

    with Path("/dev/null").open("w") as nowhere:
        config = RecordConfig(ports=tuple(f"{label}=/dev/{label}" for label in LABELS), duration=58.0)
        tracemalloc.start()
        try:
            result = record(
                config,
                tmp_path / "a.mcap",
                computer=computer,
                console=Console(file=nowhere),
                watch={"test": read_memory},
            )
        finally:
            tracemalloc.stop()
    assert sum(node["samples"] for node in result.nodes.values()) == sum(n.sent for n in nodes.values())
    early, late = (min(memory[second + k] for k in range(8)) for second in (20, 49))
    assert late - early < 100_000
