"""Mutate rosbags at meaningful places: database values and tables, compression, ROS 1 records, metadata."""

from __future__ import annotations

import random
import sqlite3
import struct
from contextlib import closing

import zstandard

from fuzz.mutate_mcap import NUMBERS, torn

VALUES = (
    "NULL", "'text'", "''", "-1", "0", "1e300", "9e999", "9223372036854775807", "-9223372036854775808",
    "4611686018427387904", "zeroblob(0)", "zeroblob(5)", "zeroblob(70000)", "X'00'", "X'00010000'",
    "randomblob(300)", "CAST(X'2feda080ff' AS TEXT)", "'/a' || char(27) || '[31m' || char(10)",
    "hex(zeroblob(2500))", "'cdr'", "'ros1'", "'sensor_msgs/msg/Imu'", "'sensor_msgs/msg/JointState'",
    "'std_msgs/msg/String'", "'std_msgs/msg/Float64MultiArray'", "'nav_msgs/msg/Odometry'",
    "'/hubodo/events'", "'/left/imu'", "'/imu/left_wheel'", "'/odom'", "char(55295)",
)  # fmt: skip
"""SQL expressions for a column; the numbers include the limits of int64 and infinity (9e999)."""
COLUMNS = (
    "messages.data", "messages.data", "messages.timestamp", "messages.topic_id", "topics.name", "topics.type",
    "topics.serialization_format", "topics.id", "topics.offered_qos_profiles",
    "message_definitions.topic_type", "message_definitions.encoding",
    "message_definitions.encoded_message_definition",
)  # fmt: skip
ENDLESS_ROWS = (
    "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) "
    "SELECT n AS id, 1 AS topic_id, n AS timestamp, zeroblob(300) AS data FROM r"
)
STATEMENTS = (
    "DROP TABLE topics",
    "DROP TABLE messages",
    "DROP TABLE schema",
    "DROP INDEX timestamp_idx",
    "DELETE FROM topics",
    "DELETE FROM messages",
    "DELETE FROM messages WHERE id % 3 = 0",
    "ALTER TABLE messages RENAME TO stored",
    "ALTER TABLE messages RENAME COLUMN data TO other",
    "ALTER TABLE topics RENAME COLUMN type TO kind",
    "ALTER TABLE messages RENAME TO stored; CREATE VIEW messages AS SELECT * FROM stored",
    "ALTER TABLE topics RENAME TO stored; CREATE VIEW topics AS SELECT * FROM stored",
    f"ALTER TABLE messages RENAME TO stored; CREATE VIEW messages AS {ENDLESS_ROWS}",
    f"CREATE VIEW v AS {ENDLESS_ROWS}",
    "ALTER TABLE messages ADD COLUMN more BLOB AS (zeroblob(900000000))",
    "CREATE TABLE extra(a)",
    "CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM topics; END",
    "INSERT INTO topics SELECT id + 100, name, type, serialization_format FROM topics",
    "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r LIMIT 70000) INSERT INTO topics "
    "SELECT n + 9, n, 'sensor_msgs/msg/Imu', 'cdr' FROM r",
    "INSERT INTO messages SELECT id + 1000, topic_id, timestamp, data FROM messages",
    "UPDATE messages SET topic_id = 99",
    "UPDATE messages SET timestamp = 5",
    "UPDATE messages SET timestamp = -timestamp",
    "UPDATE messages SET data = zeroblob(100000000) WHERE id = 3",
    "PRAGMA user_version = 9",
    "VACUUM",
)
ROSBAG1_FIELDS = (
    b"conn=", b"count=", b"chunk_pos=", b"index_pos=", b"conn_count=", b"chunk_count=", b"time=", b"size=",
    b"op=", b"ver=", b"type=", b"md5sum=", b"topic=", b"compression=", b"message_definition=",
)  # fmt: skip
_PAGE_BYTES, _FIRST_PAGE_HEADER_BYTES, _PAGE_HEADER_BYTES = 4096, 100, 40


def mutate_database(rng: random.Random, data: bytes) -> bytes:
    """Return a SQLite file with changed values, types, tables or bytes."""
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as base:
        base.deserialize(data)
        steps = iter(range(300))
        base.set_progress_handler(lambda: next(steps, None) is None, 100_000)  # stops endless views
        for _ in range(rng.randint(1, 4)):
            try:
                _mutate_table(rng, base)
            except sqlite3.Error:
                continue  # an earlier change made this one impossible
        data = bytes(base.serialize())
    if rng.random() < 0.3:
        return bytes(torn(rng, data))
    return _mutate_page_headers(rng, data) if rng.random() < 0.3 else data


def _mutate_table(rng: random.Random, base: sqlite3.Connection) -> None:
    choice = rng.random()
    if choice < 0.55:
        table, _, column = rng.choice(COLUMNS).partition(".")
        row, period = rng.randint(1, 90), rng.randint(1, 9)
        where = rng.choice(("", f"WHERE rowid % {period} = 0", f"WHERE rowid = {row}"))
        base.execute(f"UPDATE {table} SET {column} = {rng.choice(VALUES)} {where}")
    elif choice < 0.8:
        rows = base.execute("SELECT id, data FROM messages ORDER BY random() LIMIT 30").fetchall()
        for row, payload in rows:
            if isinstance(payload, bytes):
                changed = bytes(torn(rng, payload)) if payload else b"\0"
                base.execute("UPDATE messages SET data = ? WHERE id = ?", (changed, row))
    else:
        base.executescript(rng.choice(STATEMENTS))


def _mutate_page_headers(rng: random.Random, data: bytes) -> bytes:
    """Return a database with changed page headers and cell pointers, which can make its pages circular."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, 8)):
        page = _PAGE_BYTES * rng.randrange(max(1, len(changed) // _PAGE_BYTES))
        offset = page + (_FIRST_PAGE_HEADER_BYTES if page == 0 else 0) + rng.randrange(_PAGE_HEADER_BYTES)
        size = rng.choice((1, 2, 4))
        number = rng.choice((rng.randrange(1 << 16), *NUMBERS)) & ((1 << 8 * size) - 1)
        changed[offset : offset + size] = number.to_bytes(size, "big")
    return bytes(changed[: len(data)])


def compress_database(rng: random.Random, data: bytes) -> tuple[str, bytes]:
    """Return mode and bytes of a database compressed by file or message, sometimes damaged or a bomb."""
    compress = zstandard.ZstdCompressor(level=1).compress
    mode = rng.choice(("FILE", "MESSAGE"))
    bomb = bytes(rng.choice((0, 0, 0, 100 << 20)))
    if mode == "FILE":
        compressed = compress(data + bomb)
        return mode, bytes(torn(rng, compressed)) if rng.random() < 0.4 else compressed
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as base:
        base.deserialize(data)
        for row, payload in base.execute("SELECT id, data FROM messages").fetchall():
            compressed = compress(bomb or payload)
            compressed = bytes(torn(rng, compressed)) if rng.random() < 0.05 else compressed
            base.execute("UPDATE messages SET data = ? WHERE id = ?", (compressed, row))
            if bomb:
                break
        return mode, bytes(base.serialize())


def mutate_rosbag1(rng: random.Random, data: bytes) -> bytes:
    """Return a ROS 1 bag with changed lengths and values of record fields, or changed bytes."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, 5)):
        name = rng.choice(ROSBAG1_FIELDS)
        offsets = [offset for offset in range(4, len(changed)) if changed.startswith(name, offset)]
        if not offsets or rng.random() < 0.2:
            changed = torn(rng, bytes(changed))
            continue
        # The length of a field is in the 4 bytes before its name, its value after the equals sign.
        is_length = rng.random() < 0.3
        start = rng.choice(offsets) + (-4 if is_length else len(name))
        size = 4 if is_length else rng.choice((1, 4, 8))
        number = rng.choice((*NUMBERS, rng.randrange(len(changed) + 1)))
        changed[start : start + size] = struct.pack("<Q", number & ((1 << 64) - 1))[:size]
    return bytes(changed)


def mutate_metadata(rng: random.Random, data: bytes) -> bytes:
    """Return a metadata.yaml with changed lines, including aliases, nesting and paths outside the folder."""
    lines = data.split(b"\n")
    for _ in range(rng.randint(1, 3)):
        row = rng.randrange(len(lines))
        key = lines[row].partition(b":")[0]
        lines[row] = rng.choice((
            key + b": [[[[[[", key + b": " + b"9" * 5000, key + b": !!python/object/apply:os.system [x]",
            b"\xff", b"\t", key + b": null", key + b": {a: *b}", key + b": nan", b"&a [*a, *a]", b"",
            key + b": " + b"[" * 3000, key + b": ../../etc/passwd", key + b": file", key + b": zstd",
        ))  # fmt: skip
    return b"\n".join(lines)
