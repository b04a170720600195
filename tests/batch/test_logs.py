"""`hubodo logs` lists, searches and sums up results of `hubodo batch info`, even if the logs are deleted."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from batch.fleet_logs import FleetLog, cut, write
from in_process import hubodo

FLEET = (Path(__file__).parents[2] / "host" / "FLEET.md").read_text("utf-8")


@pytest.fixture(scope="module")
def index(tmp_path_factory, here):
    folder = tmp_path_factory.mktemp("year")
    for number in range(8):
        write(
            folder / "logs",
            FleetLog(f"van-{number % 2}", 10.0 * number, seed=number, missing=50 * (number == 3)),
        )
    cut(folder / "logs", FleetLog("van-1", 99.0, seed=99))
    done = hubodo("batch", "info", folder / "logs", "-o", folder / "index", *here)
    assert done.code == 0, done.err
    shutil.rmtree(folder / "logs")
    return folder / "index"


def list_logs(index, *options):
    done = hubodo("logs", index, *options, "--json")
    assert done.code == 0, done.err
    return json.loads(done.out)


def test_all_logs_are_listed_newest_first_with_their_sums(index):
    listing = list_logs(index)
    assert (listing["logs"], listing["gaps"], listing["vehicles"]) == (9, 1, ["van-0", "van-1"])
    assert listing["hours"] == pytest.approx(8 * 19.99 / 3600)
    starts = [row["start"] for row in listing["list"]]
    assert starts[0] == "2026-08-10T06:00:00+00:00" and starts[-1] is None
    assert starts[:-1] == sorted(starts[:-1], reverse=True)
    assert "is not an MCAP file" in listing["list"][-1]["error"] and listing["list"][0]["error"] is None
    assert [(row["month"], row["logs"]) for row in listing["months"]][:2] == [("2026-06", 3), ("2026-07", 4)]


def test_logs_are_filtered_by_vehicle_date_and_text(index):
    assert {row["vehicle"] for row in list_logs(index, "--vehicle", "van-1")["list"]} == {"van-1"}
    days = [
        row["start"][:10] for row in list_logs(index, "--from", "2026-06-11", "--to", "2026-07-01")["list"]
    ]
    assert days == ["2026-07-01", "2026-06-21", "2026-06-11"]
    assert [row["gaps"] for row in list_logs(index, "--search", "Not Explained by any")["list"]] == [1]
    assert len(list_logs(index, "--search", "20260701t06")["list"]) == 1
    assert list_logs(index, "--search", "nowhere")["list"] == []
    shown = hubodo("logs", index).out
    assert shown.startswith("9 logs of 2 vehicles") and "2026-08  1" in shown


def test_a_folder_without_an_index_is_refused_with_the_command_that_creates_it(tmp_path):
    done = hubodo("logs", tmp_path)
    assert done.code == 2 and "hubodo batch info" in done.err and done.err.count("\n") == 1


WORST = "SELECT vehicle, max(value) FROM 'table.parquet' WHERE quantity = 'missing_share' GROUP BY 1"
BROKEN = "SELECT log, error FROM 'table.parquet' WHERE status <> 'done'"


def test_three_questions_of_the_readme_are_one_line_each(index, monkeypatch):
    monkeypatch.chdir(index)
    for question in (WORST, BROKEN):
        assert question in FLEET
    assert max(run_query(WORST), key=lambda row: row[1]) == ["van-1", pytest.approx(50 / 2000)]
    (row,) = run_query(BROKEN)
    assert "is not an MCAP file" in row[1]
    hours = 'table[table.quantity == "duration"].groupby("vehicle").value.sum() / 3600'
    assert hours in FLEET
    of = eval(hours, {"table": pd.read_parquet("table.parquet")})
    assert of["van-0"] == pytest.approx(4 * 19.99 / 3600)


def run_query(question):
    """Return the rows of a DuckDB query, run in a separate process because DuckDB warns at exit."""
    code = f"import duckdb, json; print(json.dumps(duckdb.sql({question!r}).fetchall()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)
