"""Table of all results: one row per quantity of each log, and one for a log without quantities."""

from __future__ import annotations

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from hubodo.fleet.file_names import TABLE_FILE
from hubodo.fleet.missing_effects import add_q_values
from hubodo.fleet.storage import open_file_system, write_atomically

_LOG_COLUMNS = (
    "verb",
    "log",
    "vehicle",
    "start",
    "status",
    "error",
    "size",
    "cpu",
    "sha256",
    "version",
    "files",
)
_QUANTITY_COLUMNS = ("node", "quantity", "value", "sigma", "unit", "p_value")


def unfold_quantities(rows: pa.Table) -> pa.Table:
    """Unfold the `quantities` of rows of `result_store.SCHEMA`: log columns, date, quantity columns."""
    counts = pc.fill_null(pc.list_value_length(rows["quantities"]), 0)
    with_quantities, without_quantities = rows.filter(pc.greater(counts, 0)), rows.filter(pc.equal(counts, 0))
    lists = with_quantities["quantities"].combine_chunks()
    parents = pc.list_parent_indices(lists)
    numbers = pc.list_flatten(lists)
    columns = {name: with_quantities[name].take(parents) for name in _LOG_COLUMNS}
    columns |= {name: pc.struct_field(numbers, name) for name in _QUANTITY_COLUMNS}
    unfolded = pa.table(columns)
    empty = pa.table(
        {name: without_quantities[name] for name in _LOG_COLUMNS}
        | {
            name: pa.nulls(len(without_quantities), unfolded.schema.field(name).type)
            for name in _QUANTITY_COLUMNS
        }
    )
    both = pa.concat_tables([unfolded, empty.cast(unfolded.schema)])
    return both.add_column(4, "date", pc.cast(both["start"], pa.date32()))


def update_table(output: str, verb: str, rows: pa.Table) -> pd.DataFrame:
    """Replace the rows of a verb in `OUT/table.parquet` and return the whole table."""
    fs, folder = open_file_system(output)
    path, table = f"{folder}/{TABLE_FILE}", unfold_quantities(rows)
    if fs.exists(path):
        others = pq.read_table(path, filesystem=fs, filters=pc.field("verb") != verb)
        both = pa.concat_tables(
            [table, others], promote_options="default"
        )  # rows of an earlier version may have other columns
        table = both.select(table.schema.names)
    frame = add_q_values(table.sort_by([("verb", "ascending"), ("log", "ascending")]).to_pandas())
    schema = table.schema.append(pa.field("q_value", pa.float64()))
    sink = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pandas(frame, schema, preserve_index=False), sink, compression="zstd")
    write_atomically(fs, path, sink.getvalue().to_pybytes())
    return frame
