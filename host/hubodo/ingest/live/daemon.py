"""The recording loop: threads read the links, one place hands their news to the recorder and the log."""

from __future__ import annotations

import gc
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rich.console import Console

from hubodo.calibration.file import Calibration
from hubodo.errors import CalibrationError, InputError, LinkError, WireMismatch
from hubodo.ingest.link.link import LinkNews, PortLink
from hubodo.ingest.link.ports import Lister, list_devices, parse_port
from hubodo.ingest.live.localizer_thread import Answer, LocalizerThread
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.status import RecordResult, View, make_result
from hubodo.ingest.stopping import stop_on_signals
from hubodo.log.writer import McapLog
from hubodo.vehicle import Vehicle

S = 1_000_000_000
_TICK_NS = S // 50
_BATCH = 256


def steady_clock(scale: float = 1.0, zero_ns: int | None = None) -> Callable[[], int]:
    """Host time in ns since 1970 that never steps: the wall clock now, and monotonic from here on.

    With a scale, it passes `scale` times slower than the wall clock from zero_ns on.
    """
    base = time.time_ns() - time.monotonic_ns()
    if scale == 1.0:
        return lambda: base + time.monotonic_ns()
    zero = zero_ns if zero_ns is not None else base + time.monotonic_ns()
    return lambda: zero + int((base + time.monotonic_ns() - zero) / scale)


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
) -> RecordResult:
    """Records until SIGINT, SIGTERM, `stop` or the end of `config.duration`; the log is whole in each case.

    Unless config.wait, every port must open at the start; once open, a link may come and go. Raises
    InputError (a port cannot be opened, `out` exists, only strangers on the links; nothing is left
    behind then), CalibrationError (the calibration is of nodes with other serials; nothing is left behind)
    and WireMismatch (every node speaks another version; the raw frames stay in the log).
    """
    now_ns = steady_clock(config.time_scale, config.time_zero_ns)
    news: queue.SimpleQueue[LinkNews | Answer] = queue.SimpleQueue()
    links, names, gnss = _links(config, news, now_ns, lister)
    if out.exists():
        raise InputError(f"{out}: exists already; choose another name, nothing is overwritten")
    with ExitStack() as stack:
        for link in links.values():
            stack.callback(link.stop)
        if not config.wait:
            _open_all(links)
        log = stack.enter_context(
            McapLog(out, metadata=metadata, t_zero_ns=now_ns() // S * S, compression=config.compression)
        )
        for name, data in (attachments or {}).items():
            log.attach(name, "application/toml", data)
        localizer = None
        if vehicle is not None and gnss:
            localizer = LocalizerThread(log.t_zero_ns, news.put, vehicle.antenna)
            stack.callback(localizer.stop)
        recorder = Recorder(
            names,
            log,
            lambda label, data, to: links[label].send(data, to),
            now_ns,
            gnss=gnss,
            vehicle=vehicle,
            calibration=calibration,
            t_zero_ns=log.t_zero_ns,
            odometry_rate_hz=config.odometry_rate_hz,
            clock_period=config.clock_request_period,
            localizer=localizer,
        )
        view = stack.enter_context(View(Console(file=sys.stderr), now_ns()))
        stopping = stack.enter_context(stop_on_signals(stop or threading.Event()))
        stack.enter_context(_short_collections())
        verdict, duration = _run(config, links, news, recorder, localizer, log, view, now_ns, stopping)
        log.close()
    if isinstance(verdict, InputError | CalibrationError):
        out.unlink()
    if verdict is not None:
        raise verdict
    return make_result(recorder, file=str(out), duration=duration, messages=log.message_count, size=log.size)


def _run(
    config: RecordConfig,
    links: Mapping[str, PortLink],
    news: queue.SimpleQueue[LinkNews | Answer],
    recorder: Recorder,
    localizer: LocalizerThread | None,
    log: McapLog,
    view: View,
    now_ns: Callable[[], int],
    stopping: threading.Event,
) -> tuple[InputError | WireMismatch | CalibrationError | None, float]:
    """From the start of the links to the last thing that came: why it ended, and how long it took, s."""
    for link in links.values():
        link.start()
    start_ns = now_ns()
    verdict = _loop(config, news, recorder, log, view, now_ns, stopping)
    for link in links.values():
        link.stop()
    while not news.empty():
        recorder.handle(news.get_nowait())
    duration = (now_ns() - start_ns) / S
    recorder.close()
    if localizer is not None and not localizer.close():
        view.say("the graph was too slow to come to its end; the last seconds of map → odom are missing")
    while not news.empty():
        recorder.handle(news.get_nowait())
    return verdict, duration


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
    news: queue.SimpleQueue[LinkNews | Answer],
    recorder: Recorder,
    log: McapLog,
    view: View,
    now_ns: Callable[[], int],
    stopping: threading.Event,
) -> InputError | WireMismatch | CalibrationError | None:
    end_ns = None if config.duration is None else now_ns() + int(config.duration * S)
    next_tick = 0
    while not stopping.is_set():
        try:
            recorder.handle(news.get(timeout=_TICK_NS / S))
            for _ in range(_BATCH):
                recorder.handle(news.get_nowait())
        except queue.Empty:
            pass  # all that came has been handled
        now = now_ns()
        if now < next_tick:
            continue
        next_tick = now + _TICK_NS
        recorder.tick(now)
        log.tick()
        for notice in recorder.notices:
            view.say(notice)
        recorder.notices.clear()
        view.update(recorder, log.size, now)
        verdict = None if config.wait else recorder.verdict()
        if verdict is not None or (end_ns is not None and now >= end_ns):
            return verdict
    return None


def _links(
    config: RecordConfig,
    news: queue.SimpleQueue[LinkNews | Answer],
    now_ns: Callable[[], int],
    lister: Lister,
) -> tuple[dict[str, PortLink], dict[str, str | None], list[str]]:
    links: dict[str, PortLink] = {}
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
        links[label] = PortLink(port, label, news, now_ns, baud=baud, lister=lister)
        if not is_gnss:
            names[label] = port.name
    return links, names, gnss


def _open_all(links: Mapping[str, PortLink]) -> None:
    for link in links.values():
        try:
            link.open_now()
        except LinkError as error:
            raise InputError(f"{error} (or --wait for it)") from None
