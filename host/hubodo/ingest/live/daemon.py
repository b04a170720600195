"""A recording from its settings to its result: ports, logs, recorder, view and metrics put together."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from rich.console import Console

from hubodo.calibration.file import Calibration
from hubodo.errors import CalibrationError, InputError, LinkError
from hubodo.ingest.link.ports import DeviceLister, attach_keys, list_devices, parse_port
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.computer import Computer, Link, ThisComputer
from hubodo.ingest.live.localizer_thread import LocalizerThread
from hubodo.ingest.live.loop import Loop
from hubodo.ingest.live.loop import stop as stop_links
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.snapshot import Audience, LogNow, Watch, Watched
from hubodo.ingest.live.status import RecordResult, make_result
from hubodo.ingest.live.tee_sink import tee_sink
from hubodo.ingest.live.view import make_view
from hubodo.ingest.live.view_thread import ViewThread
from hubodo.ingest.node.naming import unique_name
from hubodo.ingest.stopping import stop_on_signals
from hubodo.log.log_series import LogSeries
from hubodo.log.log_writer import LogWriter
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
    watch: Mapping[str, Watch] | None = None,
    audience: Audience | None = None,
) -> RecordResult:
    """Records until SIGINT, SIGTERM, `stop` or the end of `config.duration`; the log is whole in each case.

    computer: None: this one. console: where the user is told how it goes; None: stderr. watch: called with a
    snapshot each second, in this thread; must return at once; audience: watches closely. Unless config.wait,
    every port must open at the start; once open, a link may come and go. Raises InputError (a port cannot be
    opened, `out` exists, only strangers on the links) and CalibrationError (of nodes with other serials),
    which leave nothing behind, and WireMismatch (every node speaks another version), which leaves raw frames.
    """
    computer = computer or ThisComputer(config.time_scale)
    links, names, gnss = _links(config, computer, lister)
    with ExitStack() as stack:
        stack.callback(stop_links, links)
        _open_all({} if config.wait else links)
        now_ns, zero = computer.now_ns, computer.now_ns() // NS_PER_S * NS_PER_S
        series = LogSeries(out, config.rules(), now_ns, wait=config.wait)
        stack.push(_nothing_left(series))
        log = stack.enter_context(_log(config, series, zero, now_ns, metadata, attachments or {}, vehicle))
        bulkheads = Bulkheads(now_ns)
        localizer = _localizer(vehicle, zero, computer, bulkheads, stack) if gnss else None
        listeners = {} if audience is None else audience.attach(log, series, bulkheads)
        recorder = Recorder(
            names,
            tee_sink(log, listeners, bulkheads),
            lambda label, data, to: links[label].send(data, to),
            now_ns,
            gnss=gnss,
            vehicle=vehicle,
            calibration=calibration,
            t_zero_ns=zero,
            odometry_rate_hz=config.odometry_rate_hz,
            clock_period=config.clock_request_period,
            localizer=localizer,
            bulkheads=bulkheads,
        )
        view = stack.enter_context(ViewThread(make_view(config, now_ns, console), bulkheads))
        watch = {**(watch or {}), "terminal": view.show}
        watched = _watched(config, recorder, log, series, watch, audience, now_ns, stack)
        again = threading.Event()
        stopping = stack.enter_context(stop_on_signals(stop or threading.Event(), again))
        loop = Loop(links, computer, recorder, localizer, log, series, view, watched, stopping, again)
        verdict, duration = loop.run(config.duration, judged=not config.wait)
        if verdict is not None:
            raise verdict
    messages = log.message_count - series.unrecorded_messages
    return make_result(recorder, series, duration=duration, messages=messages)


def _localizer(
    vehicle: Vehicle | None, zero_ns: int, computer: Computer, bulkheads: Bulkheads, stack: ExitStack
) -> LocalizerThread | None:
    """What puts odometry and fixes on the map; None without a vehicle, whose odometry there is."""
    if vehicle is None:
        return None
    localizer = LocalizerThread(zero_ns, computer.put, vehicle.antenna, bulkheads=bulkheads)
    stack.callback(localizer.stop)
    return localizer


def _log(
    config: RecordConfig,
    series: LogSeries,
    zero_ns: int,
    now_ns: Callable[[], int],
    metadata: Mapping[str, str] | None,
    attachments: Mapping[str, bytes],
    vehicle: Vehicle | None,
) -> LogWriter:
    """What the recorder writes to; it goes into the series."""
    log = LogWriter(
        series, metadata=metadata, t_zero_ns=zero_ns, compression=config.compression, clock=now_ns
    )
    for name, data in attachments.items():
        log.add_attachment(name, "application/toml", data)
    if vehicle is not None:
        log.write_static_frames(now_ns(), vehicle)
    return log


def _nothing_left(
    series: LogSeries,
) -> Callable[[type[BaseException] | None, BaseException | None, TracebackType | None], None]:
    """What takes the logs away when it turns out that they should never have begun."""

    def end(kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, InputError | CalibrationError):
            for path in series.paths:
                path.unlink(missing_ok=True)

    return end


def _watched(
    config: RecordConfig,
    recorder: Recorder,
    log: LogWriter,
    series: LogSeries,
    watch: dict[str, Watch],
    audience: Audience | None,
    now_ns: Callable[[], int],
    stack: ExitStack,
) -> Watched:
    """Who gets the snapshots: those who asked, and with `metrics` a server of them."""
    if config.metrics is not None:
        from hubodo.ingest.live.metrics_server import MetricsServer

        watch["metrics"] = stack.enter_context(MetricsServer(config.metrics, now_ns)).show
    return Watched(recorder, lambda: _log_now(log, series), watch, audience)


def _log_now(log: LogWriter, series: LogSeries) -> LogNow:
    free, whole = series.disk_space.free_and_total() or (None, None)
    return LogNow(
        series.path,
        series.open_size,
        log.size,
        log.message_count,
        series.is_recording,
        series.pause_reason,
        len(series.paths),
        series.messages_lost,
        free,
        whole,
    )


def _links(
    config: RecordConfig, computer: Computer, lister: DeviceLister
) -> tuple[dict[str, Link], dict[str, str | None], list[str]]:
    links: dict[str, Link] = {}
    names: dict[str, str | None] = {}
    gnss = ["gnss"] if config.gnss is not None else []
    wanted = [(text, config.baud, False) for text in config.ports]
    wanted += [(config.gnss, config.gnss_baud, True)] if config.gnss is not None else []
    seen: set[tuple[str, str]] = set()
    for text, baud, is_gnss in wanted:
        port = attach_keys(parse_port(text), config.key_path, insecure=config.insecure_udp)
        if (port.kind, port.where) in seen:
            raise InputError(f"port {text!r}: named twice; name each port once")
        seen.add((port.kind, port.where))
        label = "gnss" if is_gnss else unique_name(port.label, {*links, "gnss"})
        links[label] = computer.link(port, label, baud, lister)
        if not is_gnss:
            names[label] = port.name
    return links, names, gnss


def _open_all(links: Mapping[str, Link]) -> None:
    for link in links.values():
        try:
            link.open_now()
        except LinkError as error:
            raise InputError(f"{error} (or --wait for it)") from None
