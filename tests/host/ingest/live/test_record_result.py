"""The result of a recording as text and JSON."""

import io
from dataclasses import replace

import pytest
from rich.console import Console

from hubodo.ingest.live.record_result import RecordResult

LATENCY = {"latency_median": 0.0012, "latency_p99": 0.0101, "latency_worst": 0.25}
NODE = {
    "samples": 41_600,
    "samples_lost": 16,
    "rate_hz": 415.987,
    "gaps": {"link down": 2},
    "restarts": 1,
    "clock": {"drift_ppm": 12.34, "drift_sigma_ppm": 0.56, "source": "two way", "sigma": 0.00025},
}
RESULT = RecordResult(
    file="b.mcap",
    files=("a.mcap", "b.mcap"),
    messages_lost=0,
    removed=0,
    trouble=None,
    duration=100.04,
    messages=42_000,
    size=5_250_000,
    nodes={"left": NODE},
    links={"ttyACM0": {"frames": 2600, "frames_damaged": 3, "disconnections": 2}},
    gnss={"gps": {"fixes": 100, "checksum_errors": 1, "unread": 4}},
    odometry={"poses": 999, "distance": 123.456, "nodes": ["left", "right"], **LATENCY},
    map={"poses": 0},
    faults={"page": 2},
)


def _text(result: RecordResult) -> str:
    console = Console(file=io.StringIO(), width=160)
    result.render(console)
    return console.file.getvalue()  # type: ignore[attr-defined]


def test_the_text_has_the_figures_of_logs_nodes_links_and_odometry() -> None:
    text = _text(RESULT)
    for part in (
        "2 logs up to b.mcap: 100.0 s, 42000 messages, 5.25 MB",
        "415.99",
        "2 link down",
        "+12.3 ± 0.6 ppm",
        "0.250 ms (two way)",
        "link ttyACM0: 2600 frames, 3 damaged, 2 times disconnected",
        "gnss gps: 100 fixes, 1 bad checksums, 4 sentences not parsed",
        "page: 2 faults",
        "odometry from left and right: 999 poses, 123.46 m; latency 1.20 ms median",
        "10.10 ms p99, 250.00 ms worst",
        "map → odom: none; the heading was not observable",
    ):
        assert part in text, part
    assert "NOT RECORDED" not in text and "removed" not in text


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"messages_lost": 7}, "7 messages (see the warnings)"),
        ({"trouble": "disk full"}, "0 messages (disk full)"),
    ],
)
def test_a_recording_with_a_loss_or_an_interruption_has_failed(
    changes: dict[str, object], reason: str
) -> None:
    assert not RESULT.failed
    result = replace(RESULT, **changes)  # type: ignore[arg-type]
    assert result.failed
    assert f"NOT RECORDED: {reason}" in _text(result)


def test_a_node_without_rate_or_clock_is_printed_with_dashes() -> None:
    clock = {"drift_ppm": 0.0, "drift_sigma_ppm": 100.0, "source": "none", "sigma": 1.0}
    node = {**NODE, "rate_hz": None, "gaps": {}, "clock": clock}
    text = _text(
        replace(
            RESULT, files=("b.mcap",), nodes={"left": node}, removed=3, odometry={"poses": 0, "nodes": []}
        )
    )
    assert "b.mcap: 100.0 s" in text and "3 logs removed" in text
    assert "none" in text and text.count(" - ") == 2
    assert "odometry: no pose; it requires one second of samples" in text


def test_a_position_on_the_map_is_printed_with_its_origin_and_sigma() -> None:
    located = {
        "poses": 5,
        "latitude_deg": 48.1234567,
        "longitude_deg": 11.7654321,
        "x": 12.0,
        "y": -3.5,
        "sigma": 0.8,
        **LATENCY,
    }
    text = _text(replace(RESULT, map=located))
    assert "5 poses; last 12.00, -3.50 m from latitude 48.1234567, longitude 11.7654321 degrees" in text
    assert "1 sigma 0.80 m" in text


def test_json_keys_are_those_that_programs_read() -> None:
    assert list(RESULT.as_json()) == [
        *("file", "files", "messages_lost", "logs_removed", "trouble", "duration", "messages", "size"),
        *("nodes", "links", "gnss", "odometry", "map", "faults"),
    ]
    assert RESULT.as_json()["files"] == ["a.mcap", "b.mcap"]
