"""Manipulated bags: sizes and paths are checked, and usable messages are read."""

import json
import os
import sqlite3
import struct
import tracemalloc
from contextlib import closing
from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag1 import Writer as Bag1
from rosbags.typesys import Stores, get_typestore

from fuzz.seeds import BAG_METADATA, bag_database
from hubodo.log.rosbag1 import Rosbag1
from in_process import Done, hubodo
from repetitions import first_and_more

ROWS = 90


def bag(folder: Path, *statements: str, mode: str = "") -> Path:
    """Create a rosbag2 folder and change its database by SQL statements."""
    bag_folder = folder / "bag"
    bag_folder.mkdir()
    form = "zstd" if mode else ""
    (bag_folder / "metadata.yaml").write_text(BAG_METADATA.format(mode=mode, form=form))
    (bag_folder / "bag_0.db3").write_bytes(bag_database())
    with closing(sqlite3.connect(bag_folder / "bag_0.db3")) as base:
        for statement in statements:
            base.execute(statement)
        base.commit()
    return bag_folder


def info(path: Path, *options: object) -> Done:
    done = hubodo("info", path, "--json", *options)
    assert "defect" not in done.err
    assert (done.code, done.err.count("\n")) in ((0, 0), (2, 1)), done.err
    return done


VALUES = {"blob": "zeroblob(3)", "integer": "5", "text": "'text'", "real": "1e300", "null": "NULL"}
COLUMNS = {"data": "blob", "timestamp": "integer", "topic_id": "integer"}


@pytest.mark.parametrize(
    ("column", "value"),
    [(column, text) for column, kind in COLUMNS.items() for of, text in VALUES.items() if of != kind],
)
def test_rows_with_values_of_another_type_are_left_out_and_counted(column, value, tmp_path):
    done = info(bag(tmp_path, f"UPDATE messages SET {column} = {value} WHERE id % 9 = 0"))
    summary = json.loads(done.out)
    assert summary["messages"] == ROWS - ROWS // 9
    assert any(f"{ROWS // 9} rows are not of the types" in line for line in summary["warnings"])


@pytest.mark.parametrize("column", ["name", "type", "serialization_format"])
def test_a_topic_with_an_invalid_name_or_type_is_left_out_with_its_messages(column, tmp_path):
    summary = json.loads(info(bag(tmp_path, f"UPDATE topics SET {column} = NULL WHERE id = 2")).out)
    assert [stream["topic"] for stream in summary["streams"]] == ["/left/imu", "/odom"]
    assert any("1 rows are not of the types" in line for line in summary["warnings"])


COUNTING = "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r)"
BOMBS = {
    "a recursive view": (
        "ALTER TABLE messages RENAME TO stored",
        f"CREATE VIEW messages AS {COUNTING} SELECT 1 topic_id, n timestamp, zeroblob(9) data FROM r",
    ),
    "a generated column": (
        "DROP TABLE messages",
        "CREATE TABLE messages (topic_id INTEGER, timestamp INTEGER, data BLOB AS (zeroblob(900000000)))",
        "INSERT INTO messages VALUES (1, 1)",
    ),
    "a virtual table": (
        "DROP TABLE messages",
        "CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)",
    ),
}


@pytest.mark.parametrize("statements", BOMBS.values(), ids=BOMBS)
def test_only_stored_tables_are_read(statements, tmp_path):
    assert "messages is a view or is computed, not a stored table" in info(bag(tmp_path, *statements)).err


def test_an_endless_query_of_a_manipulated_file_is_aborted(tmp_path, monkeypatch):
    monkeypatch.setattr("hubodo.log.sqlite_bag._MIN_STEPS", 0)
    monkeypatch.setattr("hubodo.log.sqlite_bag._STEPS_PER_BYTE", 0)
    monkeypatch.setattr("hubodo.log.sqlite_bag._STEPS_BETWEEN_CHECKS", 10)
    assert "cannot be read as a rosbag (interrupted)" in info(bag(tmp_path)).err


def test_messages_that_claim_more_bytes_than_the_file_has_are_refused(tmp_path, monkeypatch):
    """Many rows of a manipulated file may share the same pages."""
    monkeypatch.setattr("hubodo.log.sqlite_bag._stored_bytes", lambda file: 20_000)
    done = info(bag(tmp_path))
    assert done.code == 2
    assert "the sum of its messages needs" in done.err
    assert "the most for a file of its size is 20000 bytes" in done.err


@pytest.mark.parametrize("mode", first_and_more("FILE", "MESSAGE"))
def test_a_compressed_bag_is_read_and_one_that_expands_beyond_its_size_is_refused(mode, tmp_path):
    compress = zstandard.ZstdCompressor().compress
    bag_folder = bag(tmp_path, mode=mode)
    file = bag_folder / "bag_0.db3"

    def pack(bomb: bytes) -> None:
        plain = file.read_bytes() if file.exists() else bag_database()
        if mode == "FILE":
            (bag_folder / "bag_0.db3.zstd").write_bytes(compress(plain + bomb))
            file.unlink(missing_ok=True)
            return
        with closing(sqlite3.connect(file)) as base:
            for number, data in base.execute("SELECT id, data FROM messages").fetchall():
                packed = compress(bomb or data)
                base.execute("UPDATE messages SET data = ? WHERE id = ?", (packed, number))
            base.commit()

    pack(b"")
    assert json.loads(info(bag_folder).out)["messages"] == ROWS
    refused = info(bag_folder, "--max-memory", "0.001" if mode == "FILE" else "0.0001")
    assert "--max-memory" in refused.err or "MB" in refused.err
    pack(bytes(100 << 20))
    done = info(bag_folder)
    assert done.code == 2
    assert "the most for a file of its size is" in done.err


def test_no_file_outside_the_folder_is_opened(tmp_path):
    bag_folder = bag(tmp_path, mode="FILE")
    (bag_folder / "bag_0.db3").rename(tmp_path / "secret.db3")
    metadata = (bag_folder / "metadata.yaml").read_text()
    (bag_folder / "metadata.yaml").write_text(metadata.replace("bag_0.db3", "../secret.db3"))
    assert info(bag_folder).code == 2


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no FIFO")
@pytest.mark.parametrize("name", ["bag_0.db3", "metadata.yaml", "bag_0.db3-wal"])
def test_a_fifo_in_a_bag_is_refused(name, tmp_path):
    bag_folder = bag(tmp_path)
    (bag_folder / name).unlink(missing_ok=True)
    os.mkfifo(bag_folder / name)
    assert "is not a regular file" in info(bag_folder).err


def ros1_bag(path: Path, count: int = 50) -> Path:
    """Create a compressed ROS 1 bag with one topic of temperatures."""
    store, kind = get_typestore(Stores.ROS1_NOETIC), "sensor_msgs/msg/Temperature"
    types = store.types
    writer = Bag1(path)
    writer.set_compression(Bag1.CompressionFormat.BZ2)
    with writer as bag_folder:
        link = bag_folder.add_connection("/left/temperature", kind, typestore=store)
        for k in range(count):
            header = types["std_msgs/msg/Header"](
                k, types["builtin_interfaces/msg/Time"](1_700_000_000 + k, 0), "f"
            )
            message = types[kind](header, float(k), 0.0)
            bag_folder.write(link, (1_700_000_000 + k) * 10**9, store.serialize_ros1(message, kind))
    return path


def test_a_message_definition_in_a_ros1_bag_is_compared_and_never_compiled(tmp_path):
    path = ros1_bag(tmp_path / "x.bag")
    summary = json.loads(info(path).out)
    assert [(s["messages"], s["rate"]) for s in summary["streams"]] == [(50, 1.0)]
    data = path.read_bytes()
    digest = get_typestore(Stores.ROS1_NOETIC).generate_msgdef("sensor_msgs/msg/Temperature")[1].encode()
    assert data.count(digest) >= 1
    assert [topic.is_cdr for topic in Rosbag1(path).topics] == [True]
    path.write_bytes(data.replace(digest, digest[::-1]))
    assert [topic.is_cdr for topic in Rosbag1(path).topics] == [False]
    renamed = path.rename(tmp_path / "y.log")  # the content decides
    assert json.loads(info(renamed).out)["messages"] == 50


def test_a_chunk_of_a_ros1_bag_expands_only_up_to_the_limit(tmp_path, monkeypatch):
    path = ros1_bag(tmp_path / "x.bag", 2000)
    assert "its index needs" in info(path, "--max-memory", "0.1").err
    # 24 kB of the index, 16 times that in memory, and 110 kB in the chunk.
    monkeypatch.setattr("hubodo.log.rosbag1._INDEX_MEMORY_RATIO", 1)
    assert "a chunk needs" in info(path, "--max-memory", "0.1").err


def test_a_record_of_a_ros1_bag_reads_no_more_than_the_file_has(tmp_path):
    path = ros1_bag(tmp_path / "x.bag")
    data = bytearray(path.read_bytes())
    index = struct.unpack_from("<Q", data, data.index(b"index_pos=") + 10)[0]
    data[index : index + 4] = b"\xff" * 4  # the length of a header: 4 GB
    path.write_bytes(data)
    tracemalloc.start()
    try:
        error = info(path).err
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert "cannot be read as a rosbag" in error
    assert peak < 100e6


def test_messages_that_do_not_fit_their_type_are_counted(tmp_path):
    store = get_typestore(Stores.ROS1_NOETIC)
    with Bag1(tmp_path / "short.bag") as bag_folder:
        link = bag_folder.add_connection("/t", "sensor_msgs/msg/Temperature", typestore=store)
        bag_folder.write(link, 10**18, b"\x00" * 7)
        bag_folder.write(link, 10**18 + 1, b"\xff" * 90)
    summary = json.loads(info(tmp_path / "short.bag").out)
    assert any("2 messages do not match their type" in line for line in summary["warnings"])
