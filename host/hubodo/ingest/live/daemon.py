"""The recording loop: threads read the links, one place hands their news to the recorder and the log."""

from __future__ import annotations

import gc
import shutil
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rich.console import Console

from hubodo.calibration.file import Calibration
from hubodo.errors import CalibrationError, InputError, LinkError, WireMismatch
from hubodo.ingest.link.ports import Lister, list_devices, parse_port
from hubodo.ingest.live.computer import Computer, Link, ThisComputer
from hubodo.ingest.live.localizer_thread import LocalizerThread
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.snapshot import LogNow, Watch, Watched
from hubodo.ingest.live.status import RecordResult, View, make_result
from hubodo.ingest.stopping import stop_on_signals
from hubodo.log.writer import McapLog
from hubodo.vehicle import Vehicle

S = 1_000_000_000
_TICK_NS = S // 50
_BATCH = 256


def record(
    config: RecordConfig,
    out: Path,
    *,
    vehicle: Vehicle | None = None,
    calibration: Calibration | None = None,
    metadata: Mapping[str, str] | None = None,
    attachments: Mapping[str, bytes] | None = None,
    lister: Lister = list_devices,
    stop: threading.Event | None = None,
    computer: Computer | None = None,
    console: Console | None = None,
    watch: Sequence[Watch] = (),
) -> RecordResult:
    """Records until SIGINT, SIGTERM, `stop` or the end of `config.duration`; the log is whole in each case.

    computer: None: this one. console: where the user is told how it goes; None: stderr. watch: called with a
    snapshot each second, in this thread; must return at once. Unless config.wait, every port must open at
    the start; once open, a link may come and go. Raises InputError (a port cannot be opened, `out` exists,
    only strangers on the links) and CalibrationError (of nodes with other serials), which leave nothing
    behind, and WireMismatch (every node speaks another version), which leaves raw frames.
    """
    computer = computer or ThisComputer(config.time_scale)
    links, names, gnss = _links(config, computer, lister)
    if out.exists():
        raise InputError(f"{out}: exists already; choose another name, nothing is overwritten")
    with ExitStack() as stack:
        stack.callback(_stop, links)
        if not config.wait:
            _open_all(links)
        zero = computer.now_ns() // S * S
        log = McapLog(
            out, metadata=metadata, t_zero_ns=zero, compression=config.compression, clock=computer.now_ns
        )
        stack.enter_context(log)
        for name, data in (attachments or {}).items():
            log.attach(name, "application/toml", data)
        localizer = None
        if vehicle is not None and gnss:
            localizer = LocalizerThread(zero, computer.put, vehicle.antenna)
            stack.callback(localizer.stop)
        recorder = Recorder(
            names,
            log,
            lambda label, data, to: links[label].send(data, to),
            computer.now_ns,
            gnss=gnss,
            vehicle=vehicle,
            calibration=calibration,
            t_zero_ns=zero,
            odometry_rate_hz=config.odometry_rate_hz,
            clock_period=config.clock_request_period,
            localizer=localizer,
        )
        view = stack.enter_context(View(console or Console(stderr=True), computer.now_ns()))
        watched = Watched(recorder, lambda: _log_now(log), [*watch, *_metrics(config, computer, stack)])
        stopping = stack.enter_context(stop_on_signals(stop or threading.Event()))
        verdict, duration = _run(config, links, computer, recorder, localizer, log, view, watched, stopping)
    if isinstance(verdict, InputError | CalibrationError):
        out.unlink()
    if verdict is not None:
        raise verdict
    return make_result(recorder, file=str(out), duration=duration, messages=log.message_count, size=log.size)


def _run(
    config: RecordConfig,
    links: Mapping[str, Link],
    computer: Computer,
    recorder: Recorder,
    localizer: LocalizerThread | None,
    log: McapLog,
    view: View,
    watched: Watched,
    stopping: threading.Event,
) -> tuple[InputError | WireMismatch | CalibrationError | None, float]:
    """From the start of the links to the last thing that came: why it ended, and how long it took, s."""
    for link in links.values():
        link.start()
    start_ns = computer.now_ns()
    with _short_collections():
        verdict = _loop(config, computer, recorder, log, view, watched, stopping)
    _stop(links)
    _handle_all(computer, recorder)
    duration = (computer.now_ns() - start_ns) / S
    recorder.close()
    if localizer is not None and not localizer.close():
        view.say("the graph was too slow to come to its end; the last seconds of map → odom are missing")
    _handle_all(computer, recorder)
    return verdict, duration


def _stop(links: Mapping[str, Link]) -> None:
    for link in links.values():
        link.stop()


def _handle_all(computer: Computer, recorder: Recorder) -> None:
    while (item := computer.news(0.0)) is not None:
        recorder.handle(item)


@contextmanager
def _short_collections() -> Iterator[None]:
    """Keeps what is loaded by now out of garbage collection, which else stops the loop for 10 ms and more."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _loop(
    config: RecordConfig,
    computer: Computer,
    recorder: Recorder,
    log: McapLog,
    view: View,
    watched: Watched,
    stopping: threading.Event,
) -> InputError | WireMismatch | CalibrationError | None:
    end_ns = None if config.duration is None else computer.now_ns() + int(config.duration * S)
    next_tick = 0
    while not stopping.is_set():
        wait = _TICK_NS / S
        for _ in range(_BATCH):
            item = computer.news(wait)
            if item is None:
                break
            recorder.handle(item)
            wait = 0.0
        now = computer.now_ns()
        if now < next_tick:
            continue
        next_tick = now + _TICK_NS
        recorder.tick(now)
        log.tick()
        for notice in recorder.notices:
            view.say(notice)
        recorder.notices.clear()
        view.update(recorder, log.size, now)
        watched.tick(now)
        verdict = None if config.wait else recorder.verdict()
        if verdict is not None or (end_ns is not None and now >= end_ns):
            return verdict
    return None


def _metrics(config: RecordConfig, computer: Computer, stack: ExitStack) -> list[Watch]:
    if config.metrics is None:
        return []
    from hubodo.ingest.live.metrics_server import MetricsServer

    return [stack.enter_context(MetricsServer(config.metrics, computer.now_ns)).show]


def _log_now(log: McapLog) -> LogNow:
    try:
        disk = shutil.disk_usage(log.path.absolute().parent)
    except OSError:
        disk = None
    free, size = (disk.free, disk.total) if disk is not None else (None, None)
    return LogNow(log.path, log.size, log.size, log.message_count, True, None, 1, 0, free, size)


def _links(
    config: RecordConfig, computer: Computer, lister: Lister
) -> tuple[dict[str, Link], dict[str, str | None], list[str]]:
    links: dict[str, Link] = {}
    names: dict[str, str | None] = {}
    gnss = ["gnss"] if config.gnss is not None else []
    wanted = [(text, config.baud, False) for text in config.ports]
    wanted += [(config.gnss, config.gnss_baud, True)] if config.gnss is not None else []
    seen: set[tuple[str, str]] = set()
    for text, baud, is_gnss in wanted:
        port = parse_port(text)
        if (port.kind, port.where) in seen:
            raise InputError(f"port {text!r}: named twice; name each port once")
        seen.add((port.kind, port.where))
        label = "gnss" if is_gnss else port.label
        if label in links or (label == "gnss" and not is_gnss):
            label = next(f"{label}_{n}" for n in range(2, 300) if f"{label}_{n}" not in links)
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
