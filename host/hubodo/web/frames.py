"""Frames of the live page: small dictionaries of rounded numbers, sent ten times a second.

A frame has `t`, s since the start of the recording, and: `n`, for each node the rate about its own z axis
and, on a wheel, the surface speed of that wheel; `o`, odometry; `m`, the same on the map; `g`, a fix on the
map; `origin`, the origin of the map when it changes. Once a second it also has `s`, slowly changing values,
and `e`, events if there are any. Units: m, s, rad, V, °C, Hz.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from hubodo.ingest.live.odometer import Odometer
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.snapshot import NodeStatus, Snapshot
from hubodo.ingest.node.bias_filter import filter_report_json
from hubodo.ingest.node.clock import ClockSync
from hubodo.ingest.node.session import NodeSession
from hubodo.recording import Event
from hubodo.vehicle import facing_sign
from hubowire.messages import Fault

Frame = dict[str, Any]


def motion_frame(recorder: Recorder, t: float, spins: Mapping[str, float]) -> Frame:
    """Return the fast part of a frame: wheel rates, odometry and map position."""
    odometer = recorder.odometry.odometer
    frame: Frame = {"t": round(t, 2), "n": {n: _wheel(odometer, n, spin) for n, spin in spins.items()}}
    state = None if odometer is None else odometer.state
    if odometer is not None and state is not None:
        p = state.covariance
        frame["o"] = [
            *(round(state.x, 3), round(state.y, 3), round(state.heading, 4)),
            *(round(state.speed, 3), round(state.yaw_rate, 4)),
            *(_sigma(p[0, 0] + p[1, 1], 3), _sigma(p[2, 2], 4)),
            round(odometer.distance, 2),
        ]
    located = recorder.map.latest
    if located is not None:
        p = located.row.pose_covariance[0]
        x, y = located.row.position[0].tolist()
        heading = float(located.row.heading[0])
        frame["m"] = [round(x, 3), round(y, 3), round(heading, 4), _sigma(p[0, 0] + p[1, 1], 3)]
    return frame


def _wheel(odometer: Odometer | None, node: str, spin: float) -> list[float | None]:
    mount = None if odometer is None else odometer.vehicle.nodes.get(node)
    if odometer is None or mount is None or mount.side is None or mount.facing is None:
        return [round(spin, 3), None]
    speed = facing_sign(mount.facing) * spin * odometer.vehicle.wheel_radius
    return [round(spin, 3), round(speed, 3)]


def _sigma(variance: float, digits: int) -> float | None:
    return round(math.sqrt(variance), digits) if variance >= 0.0 and math.isfinite(variance) else None


def slow_frame(recorder: Recorder, snapshot: Snapshot) -> Frame:
    """Return the slow part of a frame from a snapshot of the recorder."""
    biases = {} if recorder.odometry.odometer is None else recorder.odometry.odometer.biases()
    sessions = {node.name: node for node in recorder.nodes}
    log = snapshot.log
    return {
        "seconds": round(snapshot.seconds, 1),
        "nodes": {
            node.name: _node(node, sessions.get(node.name), biases.get(node.name)) for node in snapshot.nodes
        },
        "links": {
            link.label: {
                "up": link.where is not None,
                "where": link.where or "",
                "frames": link.frames,
                "damaged": link.frames_damaged,
                "downs": link.disconnections,
                "foreign": link.foreign or "",
            }
            for link in snapshot.links
        },
        "gnss": {receiver.label: receiver.fixes for receiver in snapshot.gnss},
        "log": {
            "file": log.path.name,
            "size": log.size,
            "recording": log.recording,
            "trouble": log.trouble,
            "free": log.disk_free,
            "disk": log.disk_size,
        },
    }


def _node(
    now: NodeStatus, session: NodeSession | None, bias: tuple[Sequence[float], Sequence[float]] | None
) -> Frame:
    # A node that is a ROS 2 topic has neither a clock of its own nor health reports.
    clock = ClockSync().estimate() if session is None else session.clock.estimate()
    health = None if session is None else session.health
    return {
        "link": now.link,
        "rate": round(now.rate, 1),
        "samples": now.samples,
        "lost": now.samples_lost,
        "restarts": now.restarts,
        "silent": round(now.age, 1),
        "refused": now.refused or "",
        "clock": {
            "source": clock.source,
            "offset": None if now.clock_sigma is None else now.clock_offset,
            "sigma": now.clock_sigma,
            "ppm": round(clock.drift * 1e6, 2) if clock.drift_used else None,
            "ppm_sigma": round(clock.drift_sigma * 1e6, 2) if clock.drift_used else None,
        },
        "battery": now.battery,
        "faults": [] if health is None else [f.name.lower() for f in Fault if f & health.faults],
        "temperature": None if now.temperature is None else round(now.temperature, 2),
        "bias": None if session is None else _rounded(filter_report_json(session.filter_report)),
        "host_bias": None if bias is None else {"bias": _round_6(bias[0]), "sigma": _round_6(bias[1])},
    }


def _rounded(report: dict[str, Any] | None) -> dict[str, Any] | None:
    if report is None:
        return None
    return {**report, "bias": _round_6(report["bias"]), "sigma": _round_6(report["sigma"])}


def _round_6(values: Sequence[float | None]) -> list[float | None]:
    return [None if value is None else round(value, 6) for value in values]


def event_frame(event: Event, wall: float) -> Frame:
    """Return an event for the page; `wall` is its time in s since 1970."""
    return {"at": round(wall, 1), "kind": event.kind, "source": event.source, "text": event.text}
