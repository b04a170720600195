"""The one table of all results: a row for each number of each log, and one for a log that has none."""

from __future__ import annotations

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from hubodo.fleet.missing_effects import with_q_values
from hubodo.fleet.names import TABLE
from hubodo.fleet.place import opened, write_whole

_OF_LOG = ("verb", "log", "vehicle", "start", "status", "error", "size", "cpu", "sha256", "version", "files")
_OF_NUMBER = ("node", "quantity", "value", "sigma", "unit", "p_value")


def long_table(rows: pa.Table) -> pa.Table:
    """`finished.SCHEMA` with `quantities` unfolded: columns of the log, its date, those of the number."""
    counts = pc.fill_null(pc.list_value_length(rows["quantities"]), 0)
    some, none = rows.filter(pc.greater(counts, 0)), rows.filter(pc.equal(counts, 0))
    lists = some["quantities"].combine_chunks()
    parents = pc.list_parent_indices(lists)
    numbers = pc.list_flatten(lists)
    columns = {name: some[name].take(parents) for name in _OF_LOG}
    columns |= {name: pc.struct_field(numbers, name) for name in _OF_NUMBER}
    made = pa.table(columns)
    empty = pa.table(
        {name: none[name] for name in _OF_LOG}
        | {name: pa.nulls(len(none), made.schema.field(name).type) for name in _OF_NUMBER}
    )
    both = pa.concat_tables([made, empty.cast(made.schema)])
    return both.add_column(4, "date", pc.cast(both["start"], pa.date32()))


def write_table(output: str, verb: str, rows: pa.Table) -> pd.DataFrame:
    """Puts a verb's rows into `OUT/table.parquet`, in the place of its earlier ones; all of the table."""
    fs, folder = opened(output)
    path, made = f"{folder}/{TABLE}", long_table(rows)
    if fs.exists(path):
        others = pq.read_table(path, filesystem=fs, filters=pc.field("verb") != verb)
        both = pa.concat_tables([made, others], promote_options="default")  # of an earlier version, too
        made = both.select(made.schema.names)
    frame = with_q_values(made.sort_by([("verb", "ascending"), ("log", "ascending")]).to_pandas())
    schema = made.schema.append(pa.field("q_value", pa.float64()))
    sink = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pandas(frame, schema, preserve_index=False), sink, compression="zstd")
    write_whole(fs, path, sink.getvalue().to_pybytes())
    return frame
