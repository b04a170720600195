"""Collect the result of a recording from the recorder, its links and its logs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hubodo.ingest.link.session import LinkSession
from hubodo.ingest.live.record_result import RecordResult
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.node.bias_filter import filter_report_json
from hubodo.ingest.topic.handlers import FixHandler, ImuHandler
from hubodo.ingest.topic.session import OUT_OF_ORDER, UNDECODABLE, TopicSession
from hubodo.log.log_series import LogSeries


def build_result(recorder: Recorder, series: LogSeries, *, duration: float, messages: int) -> RecordResult:
    """Return the result of a recorder and its logs; messages: number of messages in them."""
    nodes = {}
    for node in recorder.nodes:
        counts, health = node.decoder.counts, node.health
        nodes[node.name] = {
            "link": node.link,
            "node_id": node.node_id,
            "frames": counts.frames,
            "frames_lost": counts.frames_lost,
            "frames_late": counts.frames_late,
            "frames_unread": counts.frames_undecoded,
            "samples": counts.samples,
            "samples_lost": counts.samples_lost,
            "rate_hz": node.mean_rate(),
            "saturated_batches": counts.saturated_batches,
            "gaps": dict(node.gaps),
            "restarts": counts.restarts,
            "refused": node.decoder.mismatch_text,
            "bias_filter": filter_report_json(node.filter_report),
            "battery_mv": health.battery_mv if health is not None else None,
            "clock": node.clock.estimate().as_json(),
        }
    links = {label: _link_json(link) for label, link in recorder.links.items()}
    gnss = {
        label: {
            "fixes": session.decoder.counts.fixes,
            "sentences": session.decoder.counts.sentences,
            "checksum_errors": session.decoder.counts.checksum_errors,
            "unread": session.decoder.counts.unparsed,
        }
        for label, session in recorder.gnss.items()
    }
    for label, topic in recorder.topics.items():
        links[label] = _topic_link_json(topic)
        if isinstance(topic.handler, ImuHandler):
            nodes[label] = _topic_node_json(topic)
        elif isinstance(topic.handler, FixHandler):
            gnss[label] = _topic_gnss_json(topic, topic.handler.fixes)
    return RecordResult(
        file=str(series.path),
        files=tuple(map(str, series.paths)),
        messages_lost=series.messages_lost,
        removed=series.disk_space.removed,
        trouble=series.pause_reason,
        duration=duration,
        messages=messages,
        size=series.size,
        nodes=nodes,
        links=links,
        gnss=gnss,
        odometry=_odometry_json(recorder),
        map=_map_json(recorder),
        faults=recorder.bulkheads.fault_counts(),
    )


def _odometry_json(recorder: Recorder) -> dict[str, Any] | None:
    odometer = recorder.odometry.odometer
    if odometer is None:
        return None
    state = odometer.state
    return {
        "method": "wheel filter",
        "nodes": list(odometer.nodes),
        "poses": odometer.pose_count,
        "distance": odometer.distance,
        "x": state.x if state else 0.0,
        "y": state.y if state else 0.0,
        "heading": state.heading if state else 0.0,
        **recorder.odometry.latency.as_json(),
    }


def _map_json(recorder: Recorder) -> dict[str, Any] | None:
    if not recorder.map.is_active:
        return None
    located = recorder.map.latest
    fields: dict[str, Any] = {"poses": recorder.map.pose_count, **recorder.map.latency.as_json()}
    if located is not None:
        latitude, longitude = located.origin_deg
        x, y = located.row.position[0].tolist()
        fields |= {
            "latitude_deg": latitude,
            "longitude_deg": longitude,
            "x": x,
            "y": y,
            "heading": float(located.row.heading[0]),
            "sigma": math.sqrt(float(np.trace(located.row.pose_covariance[0, :2, :2]))),
        }
    return fields


def _topic_node_json(topic: TopicSession) -> dict[str, Any]:
    return {
        "link": topic.port.label,
        "node_id": None,
        "frames": topic.messages,
        "frames_lost": topic.samples_lost,
        "frames_late": topic.damage[OUT_OF_ORDER],
        "frames_unread": topic.damage[UNDECODABLE],
        "samples": topic.samples,
        "samples_lost": topic.samples_lost,
        "rate_hz": topic.mean_rate(),
        "saturated_batches": 0,
        "gaps": dict(topic.gaps),
        "restarts": 0,
        "refused": None,
        "bias_filter": None,
        "battery_mv": None,
        "clock": topic.clock.sync.estimate().as_json(),
    }


def _topic_gnss_json(topic: TopicSession, fixes: int) -> dict[str, Any]:
    damaged = topic.damage.total()
    return {"fixes": fixes, "sentences": topic.messages, "checksum_errors": 0, "unread": damaged}


def _topic_link_json(topic: TopicSession) -> dict[str, Any]:
    return {
        "where": topic.connection.endpoint,
        "frames": topic.messages,
        "bytes": topic.bytes,
        "frames_damaged": topic.damage.total(),
        "damage": dict(topic.damage),
        "frames_cut": 0,
        "disconnections": topic.connection.disconnections,
        "faults": topic.connection.faults,
        "refused": 0,
        "senders_evicted": 0,
    }


def _link_json(link: LinkSession) -> dict[str, Any]:
    return {
        "where": link.endpoint,
        "frames": link.frames,
        "bytes": link.bytes,
        "frames_damaged": sum(link.damage.values()),
        "damage": dict(link.damage),
        "frames_cut": link.frames_cut,
        "disconnections": link.connection.disconnections,
        "faults": link.connection.faults,
        "refused": link.datagrams_refused + link.senders.frames_refused,
        "senders_evicted": link.senders.senders_evicted,
    }
