"""Set-up and run of a recording: links, logs, recorder, view and metrics, from settings to result."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from rich.console import Console

from hubodo.calibration.file import Calibration
from hubodo.errors import CalibrationError, InputError
from hubodo.ingest.link.ports import DeviceLister, list_devices
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.computer import Computer, ThisComputer
from hubodo.ingest.live.localizer_thread import LocalizerThread
from hubodo.ingest.live.loop import Loop
from hubodo.ingest.live.loop import stop_links as stop_links
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.record_links import create_links, open_links
from hubodo.ingest.live.record_output import RecordOutput
from hubodo.ingest.live.record_result import RecordResult
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.snapshot import LogStatus
from hubodo.ingest.live.snapshot_publisher import Audience, SnapshotObserver, SnapshotPublisher
from hubodo.ingest.live.status import build_result
from hubodo.ingest.live.tee_sink import TeeSink
from hubodo.ingest.live.view import create_view
from hubodo.ingest.live.view_thread import ViewThread
from hubodo.ingest.stop_signals import stop_on_signals
from hubodo.log.log_series import LogSeries
from hubodo.log.log_writer import LogWriter
from hubodo.ros2.config import Ros2Config
from hubodo.units import NS_PER_S
from hubodo.vehicle import Vehicle


def record(
    config: RecordConfig,
    out: Path,
    *,
    vehicle: Vehicle | None = None,
    calibration: Calibration | None = None,
    metadata: Mapping[str, str] | None = None,
    attachments: Mapping[str, bytes] | None = None,
    lister: DeviceLister = list_devices,
    stop: threading.Event | None = None,
    computer: Computer | None = None,
    console: Console | None = None,
    watch: Mapping[str, SnapshotObserver] | None = None,
    audience: Audience | None = None,
    ros2: Ros2Config | None = None,
) -> RecordResult:
    """Record until SIGINT, SIGTERM, `stop` or the end of `config.duration`; the log is complete in each case.

    computer: where to record, None for the computer of this process. console: output for the user, None for
    stderr. watch: function called with a snapshot each second, in this thread; it must return at once.
    audience: the live page, polled fifty times per second. ros2: completed settings of the ROS 2 node, which
    publishes if they name a transport; required for ports that are topics.

    Unless `config.wait` is set, every port must open at the start; a link that is lost later is reopened.
    Raises InputError if a port cannot be opened, `out` exists or all links carry foreign data, and
    CalibrationError for nodes with other serials; both leave no log. Raises WireMismatch for nodes of another
    protocol version, which leaves a log.
    """
    computer = computer or ThisComputer(config.time_scale)
    ports = create_links(config, computer, lister, vehicle, ros2)
    with ExitStack() as stack:
        stack.callback(stop_links, ports.links)
        open_links({} if config.wait else ports.links)
        now_ns, zero = computer.now_ns, computer.now_ns() // NS_PER_S * NS_PER_S
        series = LogSeries(out, config.rules(), now_ns, wait=config.wait)
        stack.push(_remove_refused_logs(series))
        log = stack.enter_context(_open_log(config, series, zero, now_ns, metadata, attachments, vehicle))
        bulkheads = Bulkheads(now_ns)
        localizer = _start_localizer(vehicle, zero, computer, bulkheads, stack) if ports.has_gnss else None
        listeners = {} if audience is None else dict(audience.attach(log, series, bulkheads))
        outputs = _open_outputs(config, ros2, vehicle, computer, ports.received_topics, stack)
        listeners |= {part: output.attach(bulkheads) for part, output in outputs.items()}
        recorder = Recorder(
            ports.names,
            TeeSink(log, listeners, bulkheads),
            lambda label, data, to: ports.links[label].send(data, to),
            now_ns,
            gnss=ports.nmea,
            topic_ports=ports.topics,
            vehicle=vehicle,
            calibration=calibration,
            t_zero_ns=zero,
            odometry_rate_hz=config.odometry_rate_hz,
            clock_period=config.clock_request_period,
            localizer=localizer,
            bulkheads=bulkheads,
        )
        view = stack.enter_context(ViewThread(create_view(config, now_ns, console), bulkheads))
        shown = {part: output.show for part, output in outputs.items()}
        observers = {**(watch or {}), "terminal": view.show, **shown}
        publisher = _build_publisher(config, recorder, log, series, observers, audience, now_ns, stack)
        rotate = threading.Event()
        ending = stack.enter_context(stop_on_signals(stop or threading.Event(), rotate))
        loop = Loop(ports.links, computer, recorder, localizer, log, series, view, publisher, ending, rotate)
        error, duration = loop.run(config.duration, check_fatal=not config.wait)
        if error is not None:
            raise error
    messages = log.message_count - series.unrecorded_messages
    return build_result(recorder, series, duration=duration, messages=messages)


def _start_localizer(
    vehicle: Vehicle | None, zero_ns: int, computer: Computer, bulkheads: Bulkheads, stack: ExitStack
) -> LocalizerThread | None:
    """Start the localizer; return None without a vehicle, because there is no odometry."""
    if vehicle is None:
        return None
    localizer = LocalizerThread(zero_ns, computer.put, vehicle, bulkheads=bulkheads)
    stack.callback(localizer.stop)
    return localizer


def _open_outputs(
    config: RecordConfig,
    ros2: Ros2Config | None,
    vehicle: Vehicle | None,
    computer: Computer,
    received: frozenset[str],
    stack: ExitStack,
) -> dict[str, RecordOutput]:
    """Open the outputs that are configured; received: ports that are ROS 2 topics."""
    outputs: dict[str, RecordOutput] = {}
    if ros2 is not None and ros2.publish is not None:
        # Imported here: other recordings need no ROS 2.
        from hubodo.ingest.live.ros2_output import ros2_output

        outputs["ros2"] = stack.enter_context(ros2_output(ros2, vehicle, computer, received))
    if config.mavlink is not None:
        from hubodo.ingest.live.mavlink_output import mavlink_output

        outputs["mavlink"] = stack.enter_context(mavlink_output(config.mavlink, vehicle))
    return outputs


def _open_log(
    config: RecordConfig,
    series: LogSeries,
    zero_ns: int,
    now_ns: Callable[[], int],
    metadata: Mapping[str, str] | None,
    attachments: Mapping[str, bytes] | None,
    vehicle: Vehicle | None,
) -> LogWriter:
    """Return the log writer of the series, with attachments and static frames written.

    The ports are in the metadata of every log, because decoding its frames again needs them.
    """
    metadata = {"ports": " ".join(config.ports), **(metadata or {})}
    log = LogWriter(
        series, metadata=metadata, t_zero_ns=zero_ns, compression=config.compression, clock=now_ns
    )
    for name, data in (attachments or {}).items():
        log.add_attachment(name, "application/toml", data)
    if vehicle is not None:
        log.write_static_frames(now_ns(), vehicle)
    return log


def _remove_refused_logs(
    series: LogSeries,
) -> Callable[[type[BaseException] | None, BaseException | None, TracebackType | None], None]:
    """Return an exit callback that deletes the logs after InputError or CalibrationError."""

    def end(kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, InputError | CalibrationError):
            for path in series.paths:
                path.unlink(missing_ok=True)

    return end


def _build_publisher(
    config: RecordConfig,
    recorder: Recorder,
    log: LogWriter,
    series: LogSeries,
    observers: dict[str, SnapshotObserver],
    audience: Audience | None,
    now_ns: Callable[[], int],
    stack: ExitStack,
) -> SnapshotPublisher:
    """Return the publisher of snapshots, with a metrics server if configured."""
    if config.metrics is not None:
        from hubodo.ingest.live.metrics_server import MetricsServer

        observers["metrics"] = stack.enter_context(MetricsServer(config.metrics, now_ns)).show
    return SnapshotPublisher(recorder, lambda: _read_log_status(log, series), observers, audience)


def _read_log_status(log: LogWriter, series: LogSeries) -> LogStatus:
    free, disk_size = series.disk_space.free_and_total() or (None, None)
    return LogStatus(
        series.path,
        series.open_size,
        log.size,
        log.message_count,
        series.is_recording,
        series.pause_reason,
        len(series.paths),
        series.messages_lost,
        free,
        disk_size,
    )
