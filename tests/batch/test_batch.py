"""`hubodo batch` on this computer: one table of all logs with the results of the verb for each log."""

import json
import os

import pandas as pd
import pytest

from batch.fleet_logs import NOISE, FleetLog, cut, write
from in_process import hubodo


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """Create three logs of two vehicles, one with a gap, and a broken file."""
    folder = tmp_path_factory.mktemp("fleet")
    paths = [
        write(folder, FleetLog("van-1", 0.0, seed=1)),
        write(folder, FleetLog("van-1", 7.0, seed=2, missing=150)),
        write(folder, FleetLog("van-2", 3.0, seed=3, nodes=("left", "right"))),
        cut(folder, FleetLog("van-2", 4.0, seed=4)),
    ]
    return folder, paths


def table(out, verb=None):
    read = pd.read_parquet(out / "table.parquet")
    return read if verb is None else read[read.verb == verb]


def number(read, log, quantity, node=""):
    one = read[(read.log == str(log)) & (read.quantity == quantity) & (read.node == node)]
    assert len(one) == 1
    return float(one.value.iloc[0])


def test_the_table_has_the_results_of_info_with_vehicle_and_date(fleet, tmp_path, here):
    folder, paths = fleet
    done = hubodo("batch", "info", folder, "-o", tmp_path / "out", *here, "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["done"] == 3
    read = table(tmp_path / "out")
    for path in paths[:3]:
        alone = json.loads(hubodo("info", path, "--json").out)
        for stream in alone["streams"]:
            node, _, kind = stream["topic"][1:].rpartition("/")
            if kind == "imu":
                assert number(read, path, "rate", node) == stream["rate"]
                assert number(read, path, "gaps", node) == stream["gaps"]
        assert number(read, path, "messages") == alone["messages"]
    by_log = read.groupby("log").first()
    assert by_log.vehicle[str(paths[1])] == "van-1"
    assert str(by_log.date[str(paths[1])]) == "2026-06-08"
    assert number(read, paths[1], "missing_share", "left") == pytest.approx(150 / 2000)


def test_an_unreadable_log_is_a_row_with_the_reason(fleet, tmp_path, here):
    folder, paths = fleet
    done = hubodo("batch", "allan", folder, "--node", "all", "-o", tmp_path / "out", *here, "--json")
    assert done.code == 0, done.err
    read = table(tmp_path / "out")
    row = read[read.log == str(paths[3])]
    assert list(row.status) == ["refused"] and row.quantity.isna().all()
    alone = hubodo("allan", paths[3], "--node", "all")
    assert alone.code == 2 and alone.err == f"hubodo allan: {row.error.iloc[0]}\n"
    white = read[read.quantity == "gz.N"]
    assert len(white) == 4
    assert white.value.to_numpy() == pytest.approx(NOISE / 100**0.5, rel=0.1)


def test_finished_logs_are_skipped_and_new_changed_or_renamed_ones_analysed(fleet, tmp_path, here):
    folder, out = tmp_path / "logs", tmp_path / "out"
    paths = [write(folder, FleetLog("van-1", day, seed=day)) for day in range(3)]

    def run(*options):
        done = hubodo("batch", "info", folder, "-o", out, *options, *here, "--json")
        assert done.code == 0, done.err
        return json.loads(done.out)["fresh"]

    assert run() == 3
    assert run() == 0
    write(folder, FleetLog("van-1", 5, seed=5))
    assert run() == 1
    paths[0].rename(paths[0].with_name("moved.mcap"))
    os.utime(paths[1], (0, 0))
    before = table(out).groupby("log").cpu.first()
    assert run() == 2
    after = table(out).groupby("log").cpu.first()
    assert len(after) == 4 and str(paths[0]) not in after
    assert before[str(paths[1])] > 0
    changed = write(folder, FleetLog("van-9", 9, seed=9))
    changed.replace(paths[2])
    assert run() == 1
    assert run("--rate", 100) == 4


def test_a_few_small_logs_are_processed_without_worker_processes(fleet, tmp_path, here, monkeypatch):
    def refuse(*arguments):
        raise AssertionError("a cluster was started")

    folder, _ = fleet
    shared = hubodo("batch", "info", folder, "-o", tmp_path / "shared", *here, "--json")
    monkeypatch.setattr("hubodo.fleet.engine.connect_client", refuse)
    alone = hubodo("batch", "info", folder, "-o", tmp_path / "alone", "--json")
    counts = [
        {key: json.loads(done.out)[key] for key in ("logs", "done", "refused")} for done in (shared, alone)
    ]
    assert counts[0] == counts[1] and counts[0]["done"] > 0
    columns = ["log", "node", "quantity", "value", "unit"]
    first, second = (
        table(tmp_path / name)[columns].sort_values(columns[:3]).reset_index(drop=True)
        for name in ("shared", "alone")
    )
    pd.testing.assert_frame_equal(first, second)
