"""The SQLite file of a rosbag2."""

import sqlite3
from contextlib import closing

import pytest

from hubodo.errors import InputError
from hubodo.log.sqlite_bag import iterate_messages, read_database_facts

SCHEMA = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
INSERT INTO topics VALUES (1, '/imu', 'sensor_msgs/msg/Imu', 'cdr');
INSERT INTO messages VALUES (1, 1, 20, X'02'), (2, 1, 10, X'01'), (3, 1, 30, 'text'), (4, 1, -5, X'00');
"""


@pytest.fixture
def database(tmp_path):
    path = tmp_path / "bag.db3"
    with closing(sqlite3.connect(path)) as base:
        base.executescript(SCHEMA)
    return path


def test_usable_rows_are_read_by_time_and_the_others_counted(database):
    facts = read_database_facts(database)
    assert facts.topics == ((1, "/imu", "sensor_msgs/msg/Imu", "cdr"),)
    assert (facts.n_messages, facts.n_unusable, facts.is_sortable) == (3, 1, True)
    assert list(iterate_messages(database, facts)) == [(1, 10, b"\x01"), (1, 20, b"\x02")]


@pytest.mark.parametrize(
    ("change", "error"),
    [
        (
            "ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS SELECT * FROM m",
            "is a view or is computed",
        ),
        ("ALTER TABLE messages RENAME COLUMN data TO content", "has no column data"),
        ("DROP TABLE topics", "no table topics"),
    ],
)
def test_a_table_that_rosbag2_does_not_write_is_refused(change, error, database):
    with closing(sqlite3.connect(database)) as base:
        base.executescript(change)
    with pytest.raises(InputError, match=error):
        read_database_facts(database)
