"""The index of logs."""

from datetime import date

import pandas as pd
import pytest

from hubodo.errors import InputError
from hubodo.fleet.index import IndexQuery, read_index, summarise_months

START = pd.to_datetime(["2026-06-01T08:00Z", "2026-07-02T08:00Z", None])


@pytest.fixture
def output(tmp_path):
    rows = []
    for k, log in enumerate(("/a/one.mcap", "/a/two.mcap", "/b/three.mcap")):
        shared = {"verb": "info", "log": log, "vehicle": "van-1" if k < 2 else "van-2", "start": START[k]}
        shared |= {"size": 10, "status": "done", "error": None}
        rows.append({**shared, "node": "", "quantity": "duration", "value": 3600.0})
        rows.append({**shared, "node": "", "quantity": "gaps", "value": float(k)})
        rows += [{**shared, "node": node, "quantity": "rate", "value": 200.0} for node in ("left", "right")]
    pd.DataFrame(rows).to_parquet(tmp_path / "table.parquet")
    return str(tmp_path)


def test_there_is_one_row_per_log_newest_first_and_months_are_summed(output):
    index = read_index(output, IndexQuery())
    assert index.log.tolist() == ["/a/two.mcap", "/a/one.mcap", "/b/three.mcap"]
    assert index.nodes.tolist() == ["left right"] * 3
    assert list(summarise_months(index)) == [
        ("2026-06", 1, 1.0, 0),
        ("2026-07", 1, 1.0, 1),
        ("no date", 1, 1.0, 2),
    ]


@pytest.mark.parametrize(
    ("query", "logs"),
    [
        (IndexQuery(vehicle="van-2"), ["/b/three.mcap"]),
        (IndexQuery(first=date(2026, 6, 2)), ["/a/two.mcap"]),
        (IndexQuery(last=date(2026, 6, 1)), ["/a/one.mcap"]),
        (IndexQuery(text="THREE"), ["/b/three.mcap"]),
    ],
)
def test_a_query_filters_by_vehicle_day_and_text(query, logs, output):
    assert read_index(output, query).log.tolist() == logs


def test_a_folder_without_a_table_is_refused_with_the_command_that_writes_it(tmp_path):
    with pytest.raises(InputError, match="hubodo batch info"):
        read_index(str(tmp_path), IndexQuery())
