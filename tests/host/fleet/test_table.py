"""The table of all results."""

import pyarrow as pa

from hubodo.fleet.result_store import SCHEMA
from hubodo.fleet.table import unfold_quantities, update_table


def rows(verb, *quantities):
    shared = {"verb": verb, "analysis": "x", "status": "done", "size": 1}
    number = {"node": "left", "value": 1.0, "unit": ""}
    return pa.Table.from_pylist(
        [
            {**shared, "log": f"/logs/{k}.mcap", "quantities": [{**number, "quantity": q} for q in names]}
            for k, names in enumerate(quantities)
        ],
        SCHEMA,
    )


def test_there_is_a_row_per_quantity_and_one_for_a_log_without_any():
    table = unfold_quantities(rows("allan", ["N", "B"], [], ["N"])).sort_by([("log", "ascending")])
    assert table["log"].to_pylist() == ["/logs/0.mcap"] * 2 + ["/logs/1.mcap", "/logs/2.mcap"]
    assert table["quantity"].to_pylist() == ["N", "B", None, "N"]


def test_a_verb_replaces_its_own_rows_and_leaves_those_of_others(tmp_path):
    update_table(str(tmp_path), "allan", rows("allan", ["N", "B"]))
    update_table(str(tmp_path), "info", rows("info", ["gaps"]))
    table = update_table(str(tmp_path), "allan", rows("allan", ["K"]))
    assert sorted(zip(table.verb, table.quantity, strict=True)) == [("allan", "K"), ("info", "gaps")]
    assert "q_value" in table
