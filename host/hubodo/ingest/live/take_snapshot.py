"""Snapshot of a recorder: reads the present state of its links, nodes, receivers and odometry."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hubodo.ingest.link.session import LinkSession
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.snapshot import (
    GnssStatus,
    LinkStatus,
    LogStatus,
    NodeStatus,
    OdometryStatus,
    Snapshot,
)
from hubodo.ingest.node.health import is_asleep
from hubodo.ingest.node.session import NodeSession
from hubodo.ingest.topic.handlers import FixHandler, ImuHandler
from hubodo.ingest.topic.session import TopicSession
from hubodo.units import NS_PER_S


def take_snapshot(recorder: Recorder, log: LogStatus, started_ns: int, now_ns: int) -> Snapshot:
    """Return the present status; to be called in the recorder's thread."""
    located, topics = recorder.map.latest, list(recorder.topics.values())
    return Snapshot(
        now_ns,
        started_ns,
        log,
        (
            *(_link_status(link) for link in recorder.links.values()),
            *(_topic_link_status(topic) for topic in topics),
        ),
        (
            *(_node_status(node, now_ns) for node in recorder.nodes),
            *(
                _topic_node_status(topic, topic.handler, now_ns)
                for topic in topics
                if isinstance(topic.handler, ImuHandler)
            ),
        ),
        (
            *(
                GnssStatus(
                    label,
                    session.decoder.counts.fixes,
                    session.decoder.counts.checksum_errors,
                    session.last_fix.latitude_deg if session.last_fix is not None else None,
                    session.last_fix.longitude_deg if session.last_fix is not None else None,
                )
                for label, session in recorder.gnss.items()
            ),
            *(
                _topic_gnss_status(topic, topic.handler)
                for topic in topics
                if isinstance(topic.handler, FixHandler)
            ),
        ),
        _odometry_status(recorder),
        None if located is None else (float(located.row.position[0, 0]), float(located.row.position[0, 1])),
        memory_in_use(),
        recorder.bulkheads.fault_counts(),
    )


def memory_in_use() -> int | None:
    """Return the resident memory of the process, bytes; None where the system does not report it."""
    try:
        return int(Path("/proc/self/statm").read_bytes().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError, AttributeError):
        return None


def _link_status(link: LinkSession) -> LinkStatus:
    return LinkStatus(
        link.label,
        link.endpoint,
        link.frames,
        link.bytes,
        link.damage["crc"],
        sum(link.damage.values()),
        link.connection.disconnections,
        link.foreign,
        link.connection.faults,
        link.datagrams_refused + link.senders.frames_refused,
        link.senders.senders_evicted,
    )


def _node_status(node: NodeSession, now_ns: int) -> NodeStatus:
    counts, clock, health = node.decoder.counts, node.clock.estimate(), node.health
    newest = node.samples.newest_block
    return NodeStatus(
        node.name,
        node.link,
        node.node_id,
        node.samples.rate(now_ns),
        (now_ns - node.last_frame_ns) / NS_PER_S,
        counts.frames,
        counts.frames_lost,
        counts.samples,
        counts.samples_lost,
        counts.restarts,
        clock.offset_ns / NS_PER_S,
        clock.drift,
        clock.sigma_ns / NS_PER_S if clock.source != "none" else None,
        newest.temperature if newest is not None else None,
        health.battery_mv / 1000 if health is not None and health.battery_mv else None,
        node.filter_report.bias if node.filter_report is not None else None,
        _mean_vector(newest.gyro) if newest is not None else None,
        _mean_vector(newest.accel) if newest is not None else None,
        node.decoder.mismatch_text,
        asleep=is_asleep(health),
    )


def _topic_link_status(topic: TopicSession) -> LinkStatus:
    connection = topic.connection
    return LinkStatus(
        topic.port.label,
        connection.endpoint,
        topic.messages,
        topic.bytes,
        0,
        topic.damage.total(),
        connection.disconnections,
        None,
        connection.faults,
    )


def _topic_node_status(topic: TopicSession, samples: ImuHandler, now_ns: int) -> NodeStatus:
    """Return the status of a node whose samples are messages of a topic."""
    clock, newest = topic.clock.sync.estimate(), samples.newest_block
    return NodeStatus(
        topic.port.label,
        topic.port.label,
        0,
        topic.rate(now_ns),
        (now_ns - topic.last_message_ns) / NS_PER_S,
        topic.messages,
        topic.samples_lost,
        topic.samples,
        topic.samples_lost,
        0,
        clock.offset_ns / NS_PER_S,
        clock.drift,
        clock.sigma_ns / NS_PER_S if clock.source != "none" else None,
        None,
        None,
        None,
        _mean_vector(newest.gyro) if newest is not None else None,
        _mean_vector(newest.accel) if newest is not None else None,
        None,
    )


def _topic_gnss_status(topic: TopicSession, receiver: FixHandler) -> GnssStatus:
    fix = receiver.last_fix
    return GnssStatus(
        topic.port.label,
        receiver.fixes,
        topic.damage.total(),
        None if fix is None else fix.latitude_deg,
        None if fix is None else fix.longitude_deg,
    )


def _mean_vector(rows: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = rows.mean(axis=0).tolist()
    return x, y, z


def _odometry_status(recorder: Recorder) -> OdometryStatus | None:
    odometer = recorder.odometry.odometer
    state = odometer.state if odometer is not None else None
    if odometer is None or state is None:
        return None
    (xx, xy), (_, yy) = np.asarray(state.covariance)[:2, :2].tolist()
    worst = (xx + yy) / 2 + math.hypot((xx - yy) / 2, xy)
    return OdometryStatus(
        state.x,
        state.y,
        state.heading,
        state.speed,
        state.yaw_rate,
        math.sqrt(max(worst, 0.0)),
        odometer.distance,
        odometer.pose_count,
    )
