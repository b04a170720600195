"""Cases of folders of Parquet tables: other, missing or nested columns, and false claims in the footer."""

from __future__ import annotations

import io
import random
from functools import cache
from typing import Any

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from fuzz.case import Case
from fuzz.mutate_mcap import DOUBLES, NUMBERS, torn
from fuzz.settings import SETTINGS
from fuzz.words import LOG_READERS, QUICK, at

COLUMNS: tuple[Any, ...] = (
    lambda n: pa.array(["x"] * n), lambda n: pa.array([None] * n, pa.float64()), lambda n: pa.nulls(n),
    lambda n: pa.array([[1.0, 2.0]] * n), lambda n: pa.array([{"a": 1.0}] * n),
    lambda n: pa.array([b"\xff"] * n),
    lambda n: pa.array([1 << 62] * n), lambda n: pa.array(range(n), pa.timestamp("ns")),
    lambda n: pa.array(range(n), pa.float16()) if n < 2000 else pa.array(range(n)),
    lambda n: pa.array(range(n), pa.decimal128(20, 3)), lambda n: pa.array(["x"] * n).dictionary_encode(),
    lambda n: pa.array([True] * n), lambda n: pa.array([5.0] * n), lambda n: pa.array(range(n, 0, -1)),
)  # fmt: skip


def parquet_case(rng: random.Random, files: dict[str, str]) -> Case:
    """Return a folder of tables, one of them changed. files: the CSV files to convert."""
    tables = {name.replace(".csv", ".parquet"): _table(text) for name, text in files.items()}
    name = rng.choice(list(tables))
    content = {k: _bytes(table, "snappy") for k, table in tables.items()}
    table = tables[name]
    for _ in range(rng.randint(1, 2)):
        place = rng.randrange(table.num_columns)
        label = table.column_names[place]
        choice = rng.random()
        if choice < 0.5:
            table = table.set_column(place, label, rng.choice(COLUMNS)(table.num_rows))
        elif choice < 0.7 and pa.types.is_float64(table[label].type):
            values = table[label].to_pylist()
            values[rng.randrange(len(values) or 1) : 1] = rng.choices(DOUBLES, k=1)
            table = table.set_column(place, label, pa.array(values[: table.num_rows]))
        elif choice < 0.8:
            table = table.append_column(rng.choice(("t", "", "\x1b", "x" * 9999)), table[label])
        elif choice < 0.9 and table.num_columns > 1:
            table = table.remove_column(place)
        else:
            table = table.slice(0, rng.choice((0, 1)))
    data = bytearray(_bytes(table, rng.choice(("snappy", "zstd", "gzip", "none"))))
    if rng.random() < 0.4:
        # The footer of a Parquet file is at its end, and its length before the last four bytes.
        place = len(data) - rng.randrange(4, min(600, len(data)))
        data[place : place + 4] = (rng.choice(NUMBERS) & 0xFFFFFFFF).to_bytes(4, "little")
    content[name] = torn(rng, bytes(data)) if rng.random() < 0.15 else data
    words = rng.choice((("import", "LOG", "-o", "FOLDER/out.mcap"), *LOG_READERS[:QUICK], *LOG_READERS))
    return Case(at(words, "FOLDER/log"), {**SETTINGS, **{f"log/{k}": bytes(v) for k, v in content.items()}})


@cache
def _table(text: str) -> pa.Table:
    return pyarrow.csv.read_csv(io.BytesIO(text.encode()))


def _bytes(table: pa.Table, compression: str) -> bytes:
    out = io.BytesIO()
    pq.write_table(table, out, compression=compression)
    return out.getvalue()
