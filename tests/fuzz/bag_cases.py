"""Cases of rosbags of both generations: fields of records, rows and columns of the database, metadata."""

from __future__ import annotations

import random
import sqlite3
import struct
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import foreign_logs
from fuzz.case import Case
from fuzz.mutate_mcap import NUMBERS, torn
from fuzz.settings import SETTINGS
from fuzz.words import LOG_READERS, at

_MESSAGES = 250
VALUES: tuple[Any, ...] = (
    None, "", "x", 0, -1, 1 << 62, -(1 << 63), 1e300, float("inf"), b"", b"\x00", b"\xff" * 40, bytes(300),
    "sensor_msgs/msg/Imu",
    "cdr", "ros1", "nav_msgs/msg/Odometry", "\ud7ff", "a" * 5000, "/imu/left_wheel",
)  # fmt: skip
STATEMENTS = (
    "DROP TABLE topics", "DROP TABLE messages", "DROP TABLE schema", "DELETE FROM topics",
    "DELETE FROM messages",
    "ALTER TABLE messages RENAME TO old", "ALTER TABLE topics RENAME COLUMN type TO kind",
    "CREATE TABLE extra(a)", "DELETE FROM messages WHERE id % 3 = 0", "UPDATE messages SET topic_id = 99",
    "INSERT INTO messages SELECT id + 1000, topic_id, timestamp, data FROM messages",
    "UPDATE messages SET timestamp = 5", "UPDATE messages SET timestamp = -timestamp",
    "CREATE VIEW v AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x+1 FROM c) SELECT x FROM c",
    "ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL "
    "SELECT x+1 FROM c) SELECT x AS id, 1 AS topic_id, x AS timestamp, x'00' AS data FROM c",
    "UPDATE messages SET data = zeroblob(100000000) WHERE id = 3",
)  # fmt: skip


def rosbag1_case(rng: random.Random) -> Case:
    """A ROS 1 bag with changed lengths, fields of record headers and bytes."""
    data = bytearray(_bags()["bag"])
    for _ in range(rng.randint(1, 4)):
        key = rng.choice(
            (
                b"op=",
                b"conn=",
                b"time=",
                b"size=",
                b"count=",
                b"chunk_pos=",
                b"index_pos=",
                b"ver=",
                b"topic=",
            )
        )
        places = (
            [k for k in range(len(data)) if data.startswith(key, k)]
            if rng.random() < 0.1
            else [data.find(key, rng.randrange(len(data)))]
        )
        if places and places[0] >= 4:
            place = rng.choice(places)
            # The length of a field stands before it, its value behind the equals sign.
            start = place - 4 if rng.random() < 0.3 else place + len(key)
            data[start : start + 4] = struct.pack("<I", rng.choice(NUMBERS) & 0xFFFFFFFF)
    content = bytes(torn(rng, bytes(data)) if rng.random() < 0.3 else data)
    return Case(at(_words(rng), "FOLDER/x.bag"), {**SETTINGS, "x.bag": content})


def rosbag2_case(rng: random.Random) -> Case:
    """A rosbag2 folder with a changed database, changed messages or changed metadata."""
    files = dict(_bags()["folder"])
    (name,) = (name for name in files if name.endswith(".db3"))
    choice = rng.random()
    if choice < 0.25:
        files["metadata.yaml"] = _changed_yaml(rng, files["metadata.yaml"])
    elif choice < 0.4:
        files[name] = bytes(torn(rng, files[name]))
    else:
        files[name] = _changed_database(rng, files[name])
    if rng.random() < 0.1:
        del files["metadata.yaml"]
    return Case(at(_words(rng), "FOLDER/bag"), {**SETTINGS, **{f"bag/{k}": v for k, v in files.items()}})


def _words(rng: random.Random) -> tuple[str, ...]:
    return rng.choice((*LOG_READERS[:4] * 2, *LOG_READERS, ("import", "LOG", "-o", "FOLDER/out.mcap")))


def _changed_yaml(rng: random.Random, data: bytes) -> bytes:
    lines = data.split(b"\n")
    for _ in range(rng.randint(1, 3)):
        place = rng.randrange(len(lines))
        key = lines[place].partition(b":")[0]
        lines[place] = rng.choice((
            key + b": [[[[[[", key + b": " + b"9" * 5000, key + b": !!python/object/apply:os.system [x]",
            b"\xff", b"\t",
            key + b": null", key + b": {a: *b}", key + b": nan", b"&a [*a, *a]", b"",
            key + b": " + b"[" * 3000,
            key + b": ../../etc/passwd", key + b": file", key + b": zstd",
        ))  # fmt: skip
    return b"\n".join(lines)


def _changed_database(rng: random.Random, data: bytes) -> bytes:
    with tempfile.TemporaryDirectory(prefix="hubodo-fuzz-") as folder:
        path = Path(folder) / "x.db3"
        path.write_bytes(data)
        base = sqlite3.connect(path)
        for _ in range(rng.randint(1, 3)):
            try:
                _change_database(rng, base)
            except sqlite3.Error:
                continue  # an earlier change took the table away
        base.commit()
        base.close()
        return path.read_bytes()


def _change_database(rng: random.Random, base: sqlite3.Connection) -> None:
    choice = rng.random()
    if choice < 0.25:
        base.executescript(rng.choice(STATEMENTS))
        return
    table, columns = rng.choice((
        ("topics", ("id", "name", "type", "serialization_format", "offered_qos_profiles")),
        ("messages", ("topic_id", "timestamp", "data")),
        ("message_definitions", ("topic_type", "encoding", "encoded_message_definition")),
    ))  # fmt: skip
    column, row = rng.choice(columns), rng.randint(1, 6)
    if column == "data" and rng.random() < 0.7:
        ((content,),) = base.execute("SELECT data FROM messages WHERE id = ?", (row,)).fetchall() or [(b"",)]
        base.execute("UPDATE messages SET data = ? WHERE id = ?", (bytes(torn(rng, content)), row))
        return
    where = "" if rng.random() < 0.2 else f" WHERE rowid = {row}"
    base.execute(f"UPDATE {table} SET {column} = ?{where}", (rng.choice(VALUES),))


@cache
def _bags() -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="hubodo-fuzz-") as folder:
        root = Path(folder)
        said = foreign_logs.messages(foreign_logs.drive(root))[::40]
        bag = foreign_logs.write(root / "x", "rosbag", said[:_MESSAGES])
        two = foreign_logs.write(root / "bag", "rosbag2", said[:_MESSAGES])
        return {"bag": bag.read_bytes(), "folder": {path.name: path.read_bytes() for path in two.iterdir()}}
