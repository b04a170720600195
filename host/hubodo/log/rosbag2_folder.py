"""Write a log as a rosbag2 folder (SQLite), which every ROS 2 since Foxy plays without a plugin."""

from __future__ import annotations

import errno
import shutil
import sqlite3
import tempfile
from pathlib import Path
from typing import Any

from hubodo.errors import InputError
from hubodo.log import topics
from hubodo.log.logfile import Log
from hubodo.progress_callback import Progress


def write_rosbag2(log: Log, folder: Path, *, progress: Progress | None = None) -> dict[str, int]:
    """Copy every message with a ROS 2 type unchanged; return the number of messages by topic.

    /tf_static is latched, so that players send it to late subscribers. Raises InputError if the folder
    exists. A failure leaves nothing behind.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer

    if folder.exists():
        raise InputError(f"{folder}: exists already; choose another folder, nothing is overwritten")
    if not folder.absolute().parent.is_dir():
        raise InputError(f"{folder}: its parent folder does not exist; create it first")
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.absolute().parent))
    try:
        # The name of the bag is part of its metadata, so it has its final name from the start.
        with Writer(temporary / folder.name, version=8, storage_plugin=StoragePlugin.SQLITE3) as bag:
            counts = _copy_messages(log, bag, progress)
        (temporary / folder.name).rename(folder)
    except sqlite3.Error as error:  # by no message, only by the disk
        raise OSError(errno.EIO, str(error), str(folder)) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return counts


def _copy_messages(log: Log, bag: Any, progress: Progress | None) -> dict[str, int]:
    connections: dict[int, Any] = {}
    counts: dict[str, int] = {}
    for done, message in enumerate(log.messages()):
        if message.channel not in connections:
            connections[message.channel] = _add_connection(log, bag, message.channel)
        if connections[message.channel] is not None:
            bag.write(connections[message.channel], message.log_time, message.data)
            counts[message.topic] = counts.get(message.topic, 0) + 1
        if progress and done % 10_000 == 0:
            progress(f"writing {bag.path.name}", log.progress)
    return dict(sorted(counts.items()))


def _add_connection(log: Log, bag: Any, channel: int) -> Any:
    """Add a connection for a channel to the bag; return None if its ROS 2 type is missing or incomplete."""
    from rosbags.rosbag2 import WriterError
    from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

    stream, scan = log.streams[channel], log.scan
    schema = scan.schemas.get(scan.channels[channel].schema_id)
    if stream.encoding != "cdr" or schema is None or schema.encoding != "ros2msg":
        return None
    store = get_typestore(Stores.EMPTY)
    qos = [_latched_qos()] if stream.topic == topics.TF_STATIC else []
    try:
        store.register(get_types_from_msg(schema.data.decode("utf-8", "replace"), schema.name))
        return bag.add_connection(stream.topic, schema.name, typestore=store, offered_qos_profiles=qos)
    except (TypesysError, WriterError, LookupError, ValueError, AttributeError, TypeError, RecursionError):
        return None


def _latched_qos() -> Any:
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    ever = QosTime(9223372036, 854775807)
    return Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        ever,
        ever,
        QosLiveliness.AUTOMATIC,
        ever,
        avoid_ros_namespace_conventions=False,
    )
