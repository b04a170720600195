"""A log as a rosbag2 folder in sqlite, which every ROS 2 since Foxy plays without a plugin."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hubodo.errors import InputError
from hubodo.log import topics
from hubodo.log.logfile import Log

Progress = Callable[[str, float], None]


def write_rosbag2(log: Log, folder: Path, *, progress: Progress | None = None) -> dict[str, int]:
    """Every message of the log that ROS 2 knows the type of, as it is; how many of each topic.

    A player sends /tf_static to whoever comes late, too. Raises InputError where the folder exists. A failure
    leaves nothing behind.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer

    if folder.exists():
        raise InputError(f"{folder}: exists already; choose another folder, nothing is overwritten")
    if not folder.absolute().parent.is_dir():
        raise InputError(f"{folder}: its parent folder does not exist; create it first")
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.absolute().parent))
    try:
        # The bag's own name is in its metadata.
        with Writer(temporary / folder.name, version=8, storage_plugin=StoragePlugin.SQLITE3) as bag:
            counts = _copy(log, bag, progress)
        (temporary / folder.name).rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return counts


def _copy(log: Log, bag: Any, progress: Progress | None) -> dict[str, int]:
    links: dict[int, Any] = {}
    counts: dict[str, int] = {}
    for done, message in enumerate(log.messages()):
        if message.channel not in links:
            links[message.channel] = _link(log, bag, message.channel)
        if links[message.channel] is not None:
            bag.write(links[message.channel], message.log_time, message.data)
            counts[message.topic] = counts.get(message.topic, 0) + 1
        if progress and done % 10_000 == 0:
            progress(f"writing {bag.path.name}", log.progress)
    return dict(sorted(counts.items()))


def _link(log: Log, bag: Any, channel: int) -> Any:
    """Return the topic of a channel in the bag; None for what ROS 2 has no type for, or no complete one."""
    from rosbags.rosbag2 import WriterError
    from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

    stream, found = log.streams[channel], log.scan
    schema = found.schemas.get(found.channels[channel].schema_id)
    if stream.encoding != "cdr" or schema is None or schema.encoding != "ros2msg":
        return None
    store = get_typestore(Stores.EMPTY)
    qos = [_latched()] if stream.topic == topics.TF_STATIC else []
    try:
        store.register(get_types_from_msg(schema.data.decode("utf-8", "replace"), schema.name))
        return bag.add_connection(stream.topic, schema.name, typestore=store, offered_qos_profiles=qos)
    except (TypesysError, WriterError, LookupError, ValueError, AttributeError, TypeError, RecursionError):
        return None


def _latched() -> Any:
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
