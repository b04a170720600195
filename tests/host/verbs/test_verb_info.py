"""`hubodo info`: measured rates, gaps with their causes, health, versions, damage."""

import json
from pathlib import Path

import numpy as np
import pytest

from hubodo.cli import main
from hubodo.log.log_writer import LogWriter
from hubodo.recording import Event

PERIOD_NS = 4_800_000
T0 = 1_700_000_000_000_000_000


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Write two nodes at 208 Hz, 20 µs jitter; left lacks 10 samples with an event, and 3 without."""
    path, seed = tmp_path / "drive.mcap", 2
    rng = np.random.default_rng(seed)
    with LogWriter(path, t_zero_ns=T0, metadata={"fingerprint": "abc", "firmware.left": "1.2.3"}) as writer:
        t = T0 + np.arange(416) * PERIOD_NS + rng.normal(0, 20_000, 416).astype(np.int64)
        left_received = np.ones(416, bool)
        left_received[100:110] = left_received[300:303] = False
        for node, received in (("left", left_received), ("right", np.ones(416, bool))):
            rows = np.zeros((int(received.sum()), 3))
            writer.write_imu(node, t[received], t[received] + 5_000_000, rows, rows)
        writer.write_event(
            Event(
                int(t[99]), "gap", "usb0", "unplugged",
                {"node": "left", "samples_lost": 10, "cause": "USB unplugged", "duration_s": 0.05},
            )
        )  # fmt: skip
        for battery in (3900, 3700):
            writer.write_event(
                Event(int(t[-1]), "health", "left", "", {"node": "left", "battery_mv": battery})
            )
    return path


def info(path: Path, capsys) -> dict:
    assert main(["info", str(path), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_rate_jitter_and_gaps_of_each_stream_are_correct(log: Path, capsys) -> None:
    result = info(log, capsys)
    left, right = (s for s in result["streams"] if s["topic"].endswith("/imu"))
    for stream in (left, right):
        assert stream["period"] == pytest.approx(PERIOD_NS / 1e9, rel=1e-3)
        assert stream["rate"] == pytest.approx(208.33, rel=1e-3)
        assert stream["jitter"] == pytest.approx(20e-6 * 2**0.5, rel=0.2)
    assert (left["messages"], left["gaps"], left["missing"]) == (403, 2, 13)
    assert (right["messages"], right["gaps"], right["missing"]) == (416, 0, 0)
    assert result["complete"] is True
    assert result["duration"] == pytest.approx(2.0, abs=0.01)
    assert result["metadata"]["firmware.left"] == "1.2.3"


def test_each_gap_in_the_data_is_listed_with_the_cause_of_its_event_if_any(log: Path, capsys) -> None:
    first, second = info(log, capsys)["gaps"]
    assert (first["missing"], first["cause"]) == (10, "USB unplugged")
    assert first["t"] == pytest.approx(99 * 0.0048, abs=1e-3)
    assert first["duration"] == pytest.approx(11 * 0.0048, rel=0.01)
    assert (second["missing"], second["cause"]) == (3, "not explained by any event")


def test_recorded_losses_are_summed_by_node_stream_and_cause(tmp_path: Path, capsys) -> None:
    with LogWriter(tmp_path / "x.mcap", t_zero_ns=0) as writer:
        for i in range(5):
            data = {
                "node": "left",
                "stream": "ImuBatch",
                "samples_lost": None if i == 4 else i,
                "frames_lost": 1,
            }
            data |= {"cause": "damage" if i % 2 else "unplugged", "duration_s": 0.5}
            writer.write_event(Event(i, "gap", "left", f"gap {i}", data))
    expected = {"node": "left", "stream": "ImuBatch"}
    assert info(tmp_path / "x.mcap", capsys)["losses"] == [
        expected | {"cause": "damage", "gaps": 2, "samples": 4, "frames": 2, "unknown": 0, "duration": 1.0},
        expected
        | {"cause": "unplugged", "gaps": 3, "samples": 2, "frames": 3, "unknown": 1, "duration": 1.5},
    ]
    assert main(["info", str(tmp_path / "x.mcap")]) == 0
    assert "left ImuBatch: 2 samples and 1 uncounted gaps, 3 frames in 3 gaps" in capsys.readouterr().out


def test_the_last_health_report_of_each_node_is_shown(log: Path, capsys) -> None:
    assert info(log, capsys)["health"] == {"left": {"node": "left", "battery_mv": 3700}}


def test_the_table_has_the_content_of_the_json(log: Path, capsys) -> None:
    result = info(log, capsys)
    assert main(["info", str(log)]) == 0
    text = capsys.readouterr().out
    for stream in result["streams"]:
        assert stream["topic"] in text
        assert str(stream["messages"]) in text
    for part in ("USB unplugged", "not explained by any event", "battery 3.7 V", "firmware.left: 1.2.3"):
        assert part in text
    assert "[" not in text.split("\n")[1]


def test_a_cut_log_is_described_with_a_warning_and_exit_0(log: Path, tmp_path: Path, capsys) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[:-700])
    result = info(cut, capsys)
    assert result["complete"] is False
    assert "was not closed" in result["warnings"][-1]


@pytest.mark.parametrize("content", [b"", b"not a log", b"\x89MCAP0\r"])
def test_a_file_that_is_not_a_log_exits_2_with_one_line(content: bytes, tmp_path: Path, capsys) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    assert main(["info", str(tmp_path / "x.mcap")]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("hubodo info: ")
    assert err.count("\n") == 1


def test_an_empty_but_valid_log_is_described(tmp_path: Path, capsys) -> None:
    LogWriter(tmp_path / "empty.mcap").close()
    result = info(tmp_path / "empty.mcap", capsys)
    assert (result["messages"], result["streams"], result["duration"], result["warnings"]) == (0, [], 0.0, [])
    assert main(["info", str(tmp_path / "empty.mcap")]) == 0


def test_a_node_is_described_once_and_a_model_in_one_line(tmp_path: Path, capsys) -> None:
    path = tmp_path / "a.mcap"
    metadata = {
        "node.left.firmware": "1.2.3",
        "node.left.rate_hz": "416",
        "simulated.model": "[vehicle]\n" * 40,
    }
    with LogWriter(path, t_zero_ns=T0, metadata=metadata) as writer:
        writer.write_event(Event(T0, "connected", "left", "left: connected at tty", {}))
    assert main(["info", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "node left: firmware 1.2.3, 416 Hz" in lines
    assert "  t = 0.000 s connected: left: connected at tty" in lines
    assert sum("simulated.model" in line for line in lines) == 1 and "wheel" not in lines[-1]
    assert not any("t_zero_ns" in line for line in lines)


def test_a_file_of_another_program_has_its_own_size_and_says_which_sensor_it_lacks(
    tmp_path: Path, capsys
) -> None:
    path = tmp_path / "gyro.csv"
    path.write_text(
        "t,gx,gy,gz\n" + "".join(f"{0.01 * k:.2f},1,2,{'nan' if k == 7 else 3}\n" for k in range(50))
    )
    assert main(["info", str(path), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["size_bytes"] == path.stat().st_size and not result["library"]
    without_accel, one_gap = sorted(result["warnings"], key=len, reverse=True)
    assert "in linear_acceleration of every message" in without_accel
    assert "in angular_velocity of 1 messages" in one_gap
    assert main(["info", str(path)]) == 0
    assert "written by" not in capsys.readouterr().out
