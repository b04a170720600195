"""Prometheus metrics and health of a recording, from a snapshot."""

from __future__ import annotations

from collections.abc import Iterator

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from hubodo.ingest.live.snapshot import Snapshot
from hubodo.version import __version__
from hubowire import FINGERPRINT

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
"""Content type of `metrics_text`."""
_MAX_SNAPSHOT_AGE_S = 10.0
"""A recorder takes a snapshot each second; an older one means that it hangs."""


def metrics_text(snapshot: Snapshot) -> bytes:
    """Return all metrics of a snapshot in the text format of Prometheus."""
    registry = CollectorRegistry()
    registry.register(_SnapshotCollector(snapshot))
    return generate_latest(registry)


def assess_health(snapshot: Snapshot, now_ns: int | None = None) -> tuple[bool, str]:
    """Return True and a status line if the recording works, else False and the problems.

    now_ns: host time, to detect a hang; None to skip that.
    """
    problems: list[str] = []
    remarks: list[str] = []
    if now_ns is not None and (now_ns - snapshot.t_ns) * 1e-9 > _MAX_SNAPSHOT_AGE_S:
        problems.append(f"the recorder has made no progress for {(now_ns - snapshot.t_ns) * 1e-9:.0f} s")
    if not snapshot.log.recording:
        problems.append(f"nothing is recorded: {snapshot.log.trouble or 'the log is closed'}")
    down = [link.label for link in snapshot.links if link.where is None]
    if down:
        (problems if len(down) == len(snapshot.links) else remarks).append(f"down: {', '.join(down)}")
    remarks += [
        f"{node.name} silent for {node.age:.0f} s"
        for node in snapshot.nodes
        if node.age > _MAX_SNAPSHOT_AGE_S
    ]
    remarks += [f"{node.name} refused" for node in snapshot.nodes if node.refused is not None]
    if problems:
        return False, "; ".join(problems + remarks)
    return True, "; ".join([f"recording {snapshot.log.path.name}", *remarks])


class _SnapshotCollector(Collector):
    """Metrics of one snapshot in base units; no label depends on the samples."""

    def __init__(self, snapshot: Snapshot) -> None:
        self._now = snapshot

    def collect(self) -> Iterator[Metric]:
        now = self._now
        build = GaugeMetricFamily(
            "hubodo_build_info", "Version and protocol of the recorder.", labels=["version", "fingerprint"]
        )
        build.add_metric([__version__, f"{FINGERPRINT:08x}"], 1)
        yield build
        yield from self._recorder()
        yield from self._links()
        yield from self._nodes()
        yield from self._faults()
        if now.odometry is not None:
            yield _counter(
                "hubodo_odometry_distance_meters", "Distance along the track.", now.odometry.distance
            )
            yield _gauge(
                "hubodo_odometry_speed_meters_per_second", "Speed of the vehicle.", now.odometry.speed
            )
        fixes = CounterMetricFamily("hubodo_gnss_fixes", "GNSS fixes.", labels=["receiver"])
        for receiver in now.gnss:
            fixes.add_metric([receiver.label], receiver.fixes)
        yield fixes

    def _recorder(self) -> Iterator[Metric]:
        log, now = self._now.log, self._now
        yield _gauge("hubodo_recording", "1 while data is written to a log.", float(log.recording))
        yield _gauge("hubodo_uptime_seconds", "Time since the start of the recording.", now.seconds)
        yield _gauge(
            "hubodo_snapshot_timestamp_seconds", "Time of the snapshot, since 1970.", now.t_ns * 1e-9
        )
        yield _counter("hubodo_recorder_bytes", "Bytes written to logs.", log.total)
        yield _counter("hubodo_recorder_messages", "Messages passed to logs.", log.messages)
        yield _counter(
            "hubodo_recorder_messages_lost", "Messages lost, contained in no log.", log.messages_lost
        )
        yield _counter("hubodo_recorder_logs", "Logs started.", log.logs)
        if log.disk_free is not None:
            yield _gauge("hubodo_disk_free_bytes", "Free space on the disk of the log.", log.disk_free)
        if now.memory is not None:
            yield _gauge("hubodo_memory_bytes", "Resident memory of the process.", now.memory)

    def _faults(self) -> Iterator[Metric]:
        faults = CounterMetricFamily(
            "hubodo_faults", "Exceptions and hangs of a part of the recorder.", labels=["part"]
        )
        for part, count in self._now.faults.items():
            faults.add_metric([part], count)
        yield faults

    def _links(self) -> Iterator[Metric]:
        up = GaugeMetricFamily("hubodo_link_up", "1 while the link is open.", labels=["link"])
        received = CounterMetricFamily(
            "hubodo_received_bytes", "Bytes received from a link.", labels=["link"]
        )
        crc = CounterMetricFamily("hubodo_crc_errors", "Frames with a wrong checksum.", labels=["link"])
        damaged = CounterMetricFamily("hubodo_frames_damaged", "Damaged frames, all causes.", labels=["link"])
        again = CounterMetricFamily("hubodo_reconnects", "Times a link was lost.", labels=["link"])
        faults = CounterMetricFamily(
            "hubodo_link_faults", "Unexpected exceptions of a port driver.", labels=["link"]
        )
        refused = CounterMetricFamily("hubodo_refused", "Datagrams and frames refused.", labels=["link"])
        evicted = CounterMetricFamily(
            "hubodo_senders_evicted", "Senders dropped before identification.", labels=["link"]
        )
        for link in self._now.links:
            up.add_metric([link.label], float(link.where is not None))
            received.add_metric([link.label], link.bytes)
            crc.add_metric([link.label], link.crc_errors)
            damaged.add_metric([link.label], link.frames_damaged)
            again.add_metric([link.label], link.disconnections)
            faults.add_metric([link.label], link.faults)
            refused.add_metric([link.label], link.refused)
            evicted.add_metric([link.label], link.senders_evicted)
        yield from (up, received, crc, damaged, again, faults, refused, evicted)

    def _nodes(self) -> Iterator[Metric]:
        by = ["link", "node"]
        families: dict[str, CounterMetricFamily | GaugeMetricFamily] = {
            "frames": CounterMetricFamily("hubodo_frames_received", "Valid frames received.", labels=by),
            "frames_lost": CounterMetricFamily(
                "hubodo_frames_lost", "Frames lost, by sequence number.", labels=by
            ),
            "samples": CounterMetricFamily("hubodo_samples", "Inertial samples.", labels=by),
            "samples_lost": CounterMetricFamily(
                "hubodo_samples_lost", "Samples lost, by sample number.", labels=by
            ),
            "restarts": CounterMetricFamily("hubodo_node_restarts", "Restarts of the node.", labels=by),
            "rate": GaugeMetricFamily("hubodo_sample_rate_hertz", "Sample rate over two seconds.", labels=by),
            "age": GaugeMetricFamily("hubodo_node_silent_seconds", "Time since the last frame.", labels=by),
            "clock_offset": GaugeMetricFamily(
                "hubodo_clock_offset_seconds", "Host time minus node time.", labels=by
            ),
            "clock_drift": GaugeMetricFamily(
                "hubodo_clock_drift_ratio", "Drift of the node clock.", labels=by
            ),
            "clock_sigma": GaugeMetricFamily(
                "hubodo_clock_sigma_seconds", "1 sigma of a mapped time.", labels=by
            ),
            "temperature": GaugeMetricFamily(
                "hubodo_temperature_celsius", "Temperature of the sensor.", labels=by
            ),
            "battery": GaugeMetricFamily("hubodo_battery_volts", "Supply voltage of the node.", labels=by),
        }
        for node in self._now.nodes:
            for name, family in families.items():
                value = getattr(node, name)
                if value is not None:
                    family.add_metric([node.link, node.name], value)
        yield from families.values()


def _gauge(name: str, documentation: str, value: float) -> Metric:
    return GaugeMetricFamily(name, documentation, value=value)


def _counter(name: str, documentation: str, value: float) -> Metric:
    return CounterMetricFamily(name, documentation, value=value)
