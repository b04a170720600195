"""Rosbags changed where they mean something: values and types of SQLite columns, tables, records of ROS 1."""

from __future__ import annotations

import random
import sqlite3
import struct
from contextlib import closing

import zstandard

from fuzz.mutate_mcap import NUMBERS, torn

VALUES = (
    "NULL", "'text'", "''", "-1", "0", "1e300", "9223372036854775807", "-9223372036854775808", "zeroblob(0)",
    "zeroblob(5)", "zeroblob(70000)", "X'00010000'", "randomblob(300)", "CAST(X'2feda080ff' AS TEXT)",
    "'/a' || char(27) || '[31m' || char(10)", "'cdr'", "'sensor_msgs/msg/JointState'",
    "'std_msgs/msg/String'", "'std_msgs/msg/Float64MultiArray'", "'nav_msgs/msg/Odometry'",
    "'/hubodo/events'", "'/left/imu'", "'/odom'",
)  # fmt: skip
COLUMNS = (
    "messages.data", "messages.data", "messages.timestamp", "messages.topic_id", "topics.name", "topics.type",
    "topics.serialization_format", "topics.id",
)  # fmt: skip
STRUCTURES = (
    "DROP TABLE topics",
    "DROP TABLE messages",
    "DROP INDEX timestamp_idx",
    "ALTER TABLE messages RENAME COLUMN data TO other",
    "ALTER TABLE messages RENAME TO stored; CREATE VIEW messages AS SELECT * FROM stored",
    "ALTER TABLE topics RENAME TO stored; CREATE VIEW topics AS SELECT * FROM stored",
    "ALTER TABLE messages RENAME TO stored; CREATE VIEW messages AS WITH RECURSIVE r(n) AS (SELECT 1 "
    "UNION ALL SELECT n + 1 FROM r) SELECT 1 topic_id, n timestamp, zeroblob(300) data FROM r",
    "ALTER TABLE messages ADD COLUMN more BLOB AS (zeroblob(900000000))",
    "CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM topics; END",
    "INSERT INTO topics SELECT id + 100, name, type, serialization_format FROM topics",
    "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r LIMIT 70000) INSERT INTO topics "
    "SELECT n + 9, n, 'sensor_msgs/msg/Imu', 'cdr' FROM r",
    "PRAGMA user_version = 9",
    "VACUUM",
)


def mutated_database(rng: random.Random, data: bytes) -> bytes:
    """A SQLite file with values of other types, other tables, or bytes changed anywhere."""
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as base:
        base.deserialize(data)
        steps = iter(range(300))
        base.set_progress_handler(lambda: next(steps, None) is None, 100_000)  # a view may never end
        for _ in range(rng.randint(1, 4)):
            try:
                _change(rng, base)
            except sqlite3.Error:
                continue  # what an earlier change made impossible
        data = bytes(base.serialize())
    if rng.random() < 0.3:
        return bytes(torn(rng, data))
    if rng.random() < 0.3:
        return _page_bytes(rng, data)
    return data


def _change(rng: random.Random, base: sqlite3.Connection) -> None:
    way = rng.random()
    if way < 0.55:
        table, _, column = rng.choice(COLUMNS).partition(".")
        where = rng.choice(
            ("", f"WHERE rowid % {rng.randint(1, 9)} = 0", f"WHERE rowid = {rng.randint(1, 90)}")
        )
        base.execute(f"UPDATE {table} SET {column} = {rng.choice(VALUES)} {where}")
    elif way < 0.8:
        rows = base.execute("SELECT id, data FROM messages ORDER BY random() LIMIT 30").fetchall()
        for number, payload in rows:
            if isinstance(payload, bytes):
                made = bytes(torn(rng, payload)) if payload else b"\0"
                base.execute("UPDATE messages SET data = ? WHERE id = ?", (made, number))
    else:
        base.executescript(rng.choice(STRUCTURES))


def _page_bytes(rng: random.Random, data: bytes) -> bytes:
    """Bytes of page headers and cell pointers, where a change makes pages shared or their order circular."""
    made = bytearray(data)
    for _ in range(rng.randint(1, 8)):
        page = 4096 * rng.randrange(max(1, len(made) // 4096))
        at = page + (100 if page == 0 else 0) + rng.randrange(40)
        size = rng.choice((1, 2, 4))
        made[at : at + size] = (
            rng.choice((rng.randrange(1 << 16), *NUMBERS)) & ((1 << 8 * size) - 1)
        ).to_bytes(size, "big")
    return bytes(made[: len(data)])


def packed_database(rng: random.Random, data: bytes) -> tuple[str, bytes]:
    """A compressed database by file or message, sometimes damaged or a bomb: (mode, bytes)."""
    compress = zstandard.ZstdCompressor(level=1).compress
    mode = rng.choice(("FILE", "MESSAGE"))
    bomb = bytes(rng.choice((0, 0, 0, 100 << 20)))
    if mode == "FILE":
        packed = compress(data + bomb)
        return mode, bytes(torn(rng, packed)) if rng.random() < 0.4 else packed
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as base:
        base.deserialize(data)
        for number, payload in base.execute("SELECT id, data FROM messages").fetchall():
            packed = compress(bomb or payload)
            packed = bytes(torn(rng, packed)) if rng.random() < 0.05 else packed
            base.execute("UPDATE messages SET data = ? WHERE id = ?", (packed, number))
            if bomb:
                break
        return mode, bytes(base.serialize())


def mutated_rosbag1(rng: random.Random, data: bytes) -> bytes:
    """A bag of ROS 1 with changed lengths and fields of its records, or bytes changed anywhere."""
    made = bytearray(data)
    for _ in range(rng.randint(1, 5)):
        name = rng.choice(
            (b"conn=", b"count=", b"chunk_pos=", b"index_pos=", b"conn_count=", b"chunk_count=", b"time=",
             b"size=", b"op=", b"ver=", b"type=", b"md5sum=", b"topic=", b"compression=",
             b"message_definition=")
        )  # fmt: skip
        places = [at for at in range(len(made)) if made.startswith(name, at)]
        if not places or rng.random() < 0.2:
            made = torn(rng, bytes(made))
            continue
        at = rng.choice(places) + len(name)
        size = rng.choice((1, 4, 8))
        number = rng.choice((*NUMBERS, rng.randrange(len(made) + 1)))
        made[at : at + size] = struct.pack("<Q", number & ((1 << 64) - 1))[:size]
    return bytes(made)
