"""The status of a recording as diagnostic_msgs/DiagnosticArray, for rqt_robot_monitor and supervisors."""

from __future__ import annotations

from typing import Any

from hubodo.ingest.live.snapshot import GnssStatus, LinkStatus, NodeStatus, Snapshot
from hubodo.log import ros2
from hubodo.ros2.cdr import encode_message
from hubodo.units import NS_PER_S

DIAGNOSTICS_TOPIC = "/diagnostics"
_OK, _WARN, _ERROR, _STALE = range(4)
_STALE_AGE_S, _SLEEP_AGE_S = 2.0, 20.0
"""Ages of the last frame beyond which a node counts as silent, the second for one that is asleep."""


def encode_diagnostics(snapshot: Snapshot, dropped: int) -> bytes:
    """Return the encoded message; dropped: records that ROS 2 subscribers did not receive."""
    status = [_log_status(snapshot, dropped)]
    status += [_link_status(link) for link in snapshot.links]
    status += [_node_status(node) for node in snapshot.nodes]
    status += [_gnss_status(gnss) for gnss in snapshot.gnss]
    if snapshot.odometry is not None:
        odometry = snapshot.odometry
        values = {"distance m": odometry.distance, "sigma m": odometry.sigma, "poses": odometry.poses}
        status.append(_entry("odometry", _OK, "running", values))
    seconds, nanoseconds = divmod(snapshot.t_ns, NS_PER_S)
    stamp = {"sec": seconds, "nanosec": nanoseconds}
    return encode_message(ros2.DIAGNOSTICS, {"header": {"stamp": stamp}, "status": status})


def _log_status(snapshot: Snapshot, dropped: int) -> dict[str, Any]:
    log = snapshot.log
    values = {
        "file": log.path,
        "messages": log.messages,
        "messages lost": log.messages_lost,
        "messages not published": dropped,
        "faults": ", ".join(f"{part}: {count}" for part, count in snapshot.faults.items()) or "none",
    }
    if not log.recording:
        return _entry("log", _ERROR, log.trouble or "not recording", values)
    return _entry("log", _WARN if snapshot.faults else _OK, "recording", values)


def _link_status(link: LinkStatus) -> dict[str, Any]:
    values = {
        "device": link.where or "none",
        "frames": link.frames,
        "frames damaged": link.frames_damaged,
        "disconnections": link.disconnections,
    }
    level, text = (_OK, "up") if link.where is not None else (_ERROR, "down")
    return _entry(f"link {link.label}", level, text, values)


def _node_status(node: NodeStatus) -> dict[str, Any]:
    values = {
        "rate Hz": round(node.rate, 2),
        "samples": node.samples,
        "samples lost": node.samples_lost,
        "restarts": node.restarts,
        "clock sigma s": "unknown" if node.clock_sigma is None else node.clock_sigma,
        "temperature degC": "unknown" if node.temperature is None else node.temperature,
        "supply V": "unknown" if node.battery is None else node.battery,
    }
    level, text = _OK, "sampling"
    if node.refused is not None:
        level, text = _ERROR, node.refused
    elif node.asleep and node.age <= _SLEEP_AGE_S:
        text = "asleep until motion"
    elif node.age > _STALE_AGE_S:
        level, text = _STALE, f"silent for {node.age:.0f} s"
    elif node.samples_lost:
        level, text = _WARN, "samples were lost"
    return _entry(f"node {node.name}", level, text, values)


def _gnss_status(gnss: GnssStatus) -> dict[str, Any]:
    has_fix = gnss.latitude_deg is not None
    values = {"fixes": gnss.fixes, "checksum errors": gnss.checksum_errors}
    return _entry(f"gnss {gnss.label}", _OK if has_fix else _WARN, "fix" if has_fix else "no fix", values)


def _entry(name: str, level: int, message: str, values: dict[str, Any]) -> dict[str, Any]:
    pairs = [{"key": key, "value": str(value)} for key, value in values.items()]
    return {"level": level, "name": f"hubodo: {name}", "message": message, "values": pairs}
