"""A snapshot for machines: the text that Prometheus reads, and whether somebody should come and look."""

from __future__ import annotations

from collections.abc import Iterator

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from hubodo.ingest.live.snapshot import Snapshot
from hubodo.version import __version__
from hubowire import FINGERPRINT

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
"""Of `metrics_text`."""
_STALE_S = 10.0
"""A recorder makes a snapshot each second; one that has not for so long hangs."""


def metrics_text(snapshot: Snapshot) -> bytes:
    """Everything that is measured, in the text format of Prometheus."""
    registry = CollectorRegistry()
    registry.register(_Told(snapshot))
    return generate_latest(registry)


def health(snapshot: Snapshot, now_ns: int | None = None) -> tuple[bool, str]:
    """Whether the recording fares well, and in words what is wrong; now_ns: host time, to notice a hang."""
    wrong: list[str] = []
    noted: list[str] = []
    if now_ns is not None and (now_ns - snapshot.t_ns) * 1e-9 > _STALE_S:
        wrong.append(f"the recorder has not moved for {(now_ns - snapshot.t_ns) * 1e-9:.0f} s")
    if not snapshot.log.recording:
        wrong.append(f"nothing is recorded: {snapshot.log.trouble or 'the log is closed'}")
    down = [link.label for link in snapshot.links if link.where is None]
    if down:
        (wrong if len(down) == len(snapshot.links) else noted).append(f"down: {', '.join(down)}")
    noted += [f"{node.name} silent for {node.age:.0f} s" for node in snapshot.nodes if node.age > _STALE_S]
    noted += [f"{node.name} refused" for node in snapshot.nodes if node.refused is not None]
    if wrong:
        return False, "; ".join(wrong + noted)
    return True, "; ".join([f"recording {snapshot.log.path.name}", *noted])


class _Told(Collector):
    """One snapshot as metrics: base units, counters with `_total`, no label that grows with the samples."""

    def __init__(self, snapshot: Snapshot) -> None:
        self._now = snapshot

    def collect(self) -> Iterator[Metric]:
        now = self._now
        build = GaugeMetricFamily("hubodo_build_info", "What runs.", labels=["version", "fingerprint"])
        build.add_metric([__version__, f"{FINGERPRINT:08x}"], 1)
        yield build
        yield from self._recorder()
        yield from self._links()
        yield from self._nodes()
        yield from self._faults()
        if now.odometry is not None:
            yield _counter("hubodo_odometry_distance_meters", "Way of the vehicle.", now.odometry.distance)
            yield _gauge("hubodo_odometry_speed_meters_per_second", "Its speed.", now.odometry.speed)
        fixes = CounterMetricFamily("hubodo_gnss_fixes", "Positions of a receiver.", labels=["receiver"])
        for receiver in now.gnss:
            fixes.add_metric([receiver.label], receiver.fixes)
        yield fixes

    def _recorder(self) -> Iterator[Metric]:
        log, now = self._now.log, self._now
        yield _gauge("hubodo_recording", "1 while what comes goes into a log.", float(log.recording))
        yield _gauge("hubodo_uptime_seconds", "Since the start.", now.seconds)
        yield _gauge("hubodo_snapshot_timestamp_seconds", "When this was so, since 1970.", now.t_ns * 1e-9)
        yield _counter("hubodo_recorder_bytes", "Bytes written into logs.", log.total)
        yield _counter("hubodo_recorder_messages", "Messages given to logs.", log.messages)
        yield _counter("hubodo_recorder_messages_lost", "Messages that no log has.", log.messages_lost)
        yield _counter("hubodo_recorder_logs", "Logs begun.", log.logs)
        if log.disk_free is not None:
            yield _gauge("hubodo_disk_free_bytes", "Room where the log is.", log.disk_free)
        if now.memory is not None:
            yield _gauge("hubodo_memory_bytes", "Resident memory of the process.", now.memory)

    def _faults(self) -> Iterator[Metric]:
        faults = CounterMetricFamily(
            "hubodo_faults", "Exceptions and hangs of a part, which cost that part alone.", labels=["part"]
        )
        for part, count in self._now.faults.items():
            faults.add_metric([part], count)
        yield faults

    def _links(self) -> Iterator[Metric]:
        up = GaugeMetricFamily("hubodo_link_up", "1 while the link is open.", labels=["link"])
        received = CounterMetricFamily("hubodo_received_bytes", "Bytes from a link.", labels=["link"])
        crc = CounterMetricFamily("hubodo_crc_errors", "Frames with a wrong checksum.", labels=["link"])
        damaged = CounterMetricFamily("hubodo_frames_damaged", "Damaged, of any cause.", labels=["link"])
        again = CounterMetricFamily("hubodo_reconnects", "Times a link was lost.", labels=["link"])
        faults = CounterMetricFamily(
            "hubodo_link_faults", "Driver errors no link should have.", labels=["link"]
        )
        refused = CounterMetricFamily("hubodo_refused", "Datagrams and frames not let in.", labels=["link"])
        evicted = CounterMetricFamily("hubodo_senders_evicted", "Never identified.", labels=["link"])
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
            "frames": CounterMetricFamily("hubodo_frames_received", "Undamaged frames.", labels=by),
            "frames_lost": CounterMetricFamily("hubodo_frames_lost", "By sequence number.", labels=by),
            "samples": CounterMetricFamily("hubodo_samples", "Inertial samples.", labels=by),
            "samples_lost": CounterMetricFamily("hubodo_samples_lost", "By sample number.", labels=by),
            "restarts": CounterMetricFamily("hubodo_node_restarts", "Starts but the first.", labels=by),
            "rate": GaugeMetricFamily("hubodo_sample_rate_hertz", "Over two seconds.", labels=by),
            "age": GaugeMetricFamily("hubodo_node_silent_seconds", "Since its last frame.", labels=by),
            "clock_offset": GaugeMetricFamily("hubodo_clock_offset_seconds", "Host minus node.", labels=by),
            "clock_drift": GaugeMetricFamily("hubodo_clock_drift_ratio", "Of the node's clock.", labels=by),
            "clock_sigma": GaugeMetricFamily("hubodo_clock_sigma_seconds", "Of a mapped time.", labels=by),
            "temperature": GaugeMetricFamily("hubodo_temperature_celsius", "Of the sensor.", labels=by),
            "battery": GaugeMetricFamily("hubodo_battery_volts", "Supply of the node.", labels=by),
        }
        for node in self._now.nodes:
            for name, family in families.items():
                value = getattr(node, name)
                if value is not None:
                    family.add_metric([node.link, node.name], value)
        yield from families.values()


def _gauge(name: str, says: str, value: float) -> Metric:
    return GaugeMetricFamily(name, says, value=value)


def _counter(name: str, says: str, value: float) -> Metric:
    return CounterMetricFamily(name, says, value=value)
