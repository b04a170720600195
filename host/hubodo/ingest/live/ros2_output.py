"""A recording as a live ROS 2 node: odometry, frames, sensor data and diagnostics while they happen."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.computer import Computer
from hubodo.ingest.live.output_thread import OutputThread
from hubodo.ingest.live.ros2_diagnostics import DIAGNOSTICS_TOPIC, encode_diagnostics
from hubodo.ingest.live.ros2_services import Ros2Services
from hubodo.ingest.live.snapshot import Snapshot
from hubodo.ingest.live.tee_sink import RecordListener
from hubodo.log import ros2, topics
from hubodo.log.log_writer import LogWriter
from hubodo.log.mcap_file import Compression, MessageIndexes
from hubodo.log.records import (
    Battery,
    GnssFix,
    ImuBlock,
    ImuNoise,
    LogRecord,
    MagneticField,
    Odometry,
    Transform,
)
from hubodo.ros2.config import Ros2Config
from hubodo.ros2.names import PUBLISHED_TYPES, topic_qos
from hubodo.ros2.node import Node, Publisher
from hubodo.ros2.transport import shared_node
from hubodo.vehicle import Vehicle

_MESSAGE_HEADER = struct.Struct("<BQHIqq")
_MAX_QUEUED_RECORDS = 2048
"""Queued records, about three seconds of four nodes; beyond that the oldest are dropped."""
_PUBLISHED_RECORDS = (ImuBlock, ImuNoise, Battery, MagneticField, Odometry, Transform, GnssFix)


class _PublishedTopics:
    """A `ChunkTarget` that publishes each message of the topics that ROS 2 programs know."""

    path = Path()
    size = 0

    def __init__(self, node: Node) -> None:
        self.closed = False
        self._node = node
        self._schemas: list[str] = [""]
        self._publishers: list[Publisher | None] = []

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Note the type of a message; see `ChunkTarget`."""
        self._schemas.append(name)
        return len(self._schemas) - 1

    def add_channel(self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Create the publisher of a topic; see `ChunkTarget`."""
        kind = self._schemas[schema_id]
        is_published = kind in PUBLISHED_TYPES and not topic.startswith(topics.HUBODO_PREFIX)
        publisher = self._node.create_publisher(topic, kind, topic_qos(topic, kind)) if is_published else None
        self._publishers.append(publisher)
        return len(self._publishers) - 1

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Ignore metadata, which ROS 2 does not carry."""

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Ignore attachments, which ROS 2 does not carry."""

    def add_chunk(self, records: bytes, indexes: MessageIndexes, compression: Compression) -> None:
        """Publish each message of a chunk."""
        offset = 0
        while offset < len(records):
            _, length, channel, *_ = _MESSAGE_HEADER.unpack_from(records, offset)
            publisher = self._publishers[channel]
            if publisher is not None:
                publisher.publish(records[offset + _MESSAGE_HEADER.size : offset + 9 + length])
            offset += 9 + length

    def finish(self) -> None:
        """Stop publishing; see `ChunkTarget`."""
        self.closed = True


class Ros2Output:
    """A `RecordOutput` that publishes from its own thread; its topics are those of the log."""

    def __init__(
        self,
        node: Node,
        vehicle: Vehicle | None,
        computer: Computer,
        *,
        name: str,
        received: frozenset[str] = frozenset(),
    ) -> None:
        """Publish the static frames of the vehicle.

        computer: its clock, and its queue for requests to the services of the node `name`. received: ports
        that are ROS 2 topics; not published again.
        """
        self._received = received
        self._log = LogWriter(_PublishedTopics(node), clock=None)
        self._diagnostics = node.create_publisher(
            DIAGNOSTICS_TOPIC, ros2.DIAGNOSTICS, topic_qos(DIAGNOSTICS_TOPIC, ros2.DIAGNOSTICS)
        )
        if vehicle is not None:
            self._log.write_static_frames(computer.now_ns(), vehicle)
            self._log.flush()
        self._thread: OutputThread[LogRecord | Snapshot | Callable[[], None]] | None = None
        self._services = Ros2Services(node, name, computer.put, computer.now_ns, self._defer)

    @property
    def waiting_count(self) -> int:
        """Number of queued records."""
        return 0 if self._thread is None else self._thread.waiting_count

    @property
    def dropped(self) -> int:
        """Number of records that were not published because subscribers were too slow."""
        return 0 if self._thread is None else self._thread.dropped

    def attach(self, bulkheads: Bulkheads) -> RecordListener:
        """Start the thread; see `RecordOutput`."""
        self._thread = OutputThread("ros2", lambda: self._publish, bulkheads, capacity=_MAX_QUEUED_RECORDS)
        self._services.start()
        return self._queue

    def show(self, snapshot: Snapshot) -> None:
        """Queue the diagnostics; see `RecordOutput`."""
        if self._thread is not None:
            self._thread.put(snapshot)

    def close(self) -> None:
        """Publish what is queued, for half a second at most."""
        if self._thread is not None:
            self._thread.close()

    def _queue(self, record: LogRecord) -> None:
        if self._thread is None or not isinstance(record, _PUBLISHED_RECORDS):
            return
        source = "gnss" if isinstance(record, GnssFix) else getattr(record, "node", None)
        if source not in self._received:
            self._thread.put(record)

    def _defer(self, action: Callable[[], None]) -> None:
        if self._thread is not None:
            self._thread.put(action)

    def _publish(self, item: LogRecord | Snapshot | Callable[[], None]) -> None:
        """Publish one record at once, because subscribers control vehicles with it, or send a reply."""
        if callable(item):
            item()
            return
        if isinstance(item, Snapshot):
            self._diagnostics.publish(encode_diagnostics(item, self.dropped))
            return
        self._log.write_record(item)
        self._log.flush()


@contextmanager
def ros2_output(
    config: Ros2Config, vehicle: Vehicle | None, computer: Computer, received: frozenset[str] = frozenset()
) -> Iterator[Ros2Output]:
    """Provide the output to ROS 2; config: completed, with a transport to publish on; see `Ros2Output`."""
    assert config.publish is not None
    with shared_node(config.publish, config) as node:
        output = Ros2Output(node, vehicle, computer, name=config.node, received=received)
        try:
            yield output
        finally:
            output.close()
