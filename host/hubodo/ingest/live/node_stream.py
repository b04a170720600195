"""Samples of one node during a recording, for procedures that move the node and evaluate its samples."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import HubodoError, InputError, LinkError
from hubodo.ingest.link.link import LinkReport
from hubodo.ingest.link.ports import attach_keys, list_devices, parse_port
from hubodo.ingest.live.computer import Computer, ThisComputer
from hubodo.ingest.live.recorder import Recorder
from hubodo.log.log_writer import LogWriter, WritableRecord
from hubodo.log.records import ImuBlock
from hubodo.units import NS_PER_S
from hubowire.budget import UART_BAUD

_QUEUE_TIMEOUT_S = 0.02
_MAX_SILENCE_S = 8.0
"""A node silent for this long is lost; a start with clock synchronisation takes two seconds."""


@dataclass(frozen=True)
class Samples:
    """Samples of a node in node axes.

    t: (N,) s since the log's start; gyro: (N, 3) rad/s; accel: (N, 3) m/s².
    """

    t: Array
    gyro: Array
    accel: Array


@dataclass(frozen=True)
class _TurntableRow:
    t_ns: int
    angle: float
    moving: bool


class _BufferingLog(LogWriter):
    """A log that also queues the IMU samples it writes."""

    def __init__(
        self, path: Path, *, t_zero_ns: int, metadata: Mapping[str, str], clock: Callable[[], int]
    ) -> None:
        super().__init__(path, t_zero_ns=t_zero_ns, metadata=metadata, clock=clock)
        self.imu_blocks: queue.SimpleQueue[tuple[str, Array, Array, Array]] = queue.SimpleQueue()
        self._zero_ns = t_zero_ns

    def write_record(self, record: WritableRecord, /) -> None:
        """Write a record to the log and queue it if it is a block of samples."""
        super().write_record(record)
        if isinstance(record, ImuBlock):
            t = np.asarray((record.t_ns - self._zero_ns) * 1e-9, np.float64)
            self.imu_blocks.put((record.node, t, record.gyro, record.accel))


class NodeStream:
    """A recording of the node on a port, in a thread of its own; a context manager.

    port: as for `hubodo record`. out: path of the log. node: its name, None for the only one on the port.
    on_notice: called with each line for the user. computer: None for the computer of this process. Raises
    InputError when `out` exists or the port cannot be opened.
    """

    def __init__(
        self,
        port: str,
        out: Path,
        *,
        node: str | None = None,
        baud: int = UART_BAUD,
        metadata: Mapping[str, str] | None = None,
        on_notice: Callable[[str], None] = lambda line: None,
        computer: Computer | None = None,
    ) -> None:
        if out.exists():
            raise InputError(f"{out}: exists already; choose another name, nothing is overwritten")
        self.node = node
        self._on_notice = on_notice
        self._computer = computer or ThisComputer()
        self._zero_ns = self._computer.now_ns() // NS_PER_S * NS_PER_S
        name = attach_keys(parse_port(port), None, insecure=())
        self._label = name.label
        self._link = self._computer.create_link(name, name.label, baud, list_devices)
        try:
            self._link.open_now()
        except LinkError as error:
            raise InputError(str(error)) from None
        clock = self._computer.now_ns
        self._log = _BufferingLog(out, t_zero_ns=self._zero_ns, metadata=metadata or {}, clock=clock)
        self._recorder = Recorder(
            {name.label: name.name},
            self._log,
            lambda label, data, to: self._link.send(data, to),
            self._computer.now_ns,
            t_zero_ns=self._zero_ns,
        )
        self._stopping = threading.Event()
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="node stream", daemon=True)

    def __enter__(self) -> Self:
        self._link.start()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopping.set()
        self._thread.join()
        self._link.stop()
        self._log.close()
        if isinstance(self._failure, InputError):
            self._log.path.unlink()  # no node was received

    def now(self) -> float:
        """Return the time since the log's start, s, on the host clock."""
        return (self._computer.now_ns() - self._zero_ns) * 1e-9

    @property
    def serial(self) -> str:
        """Serial of the node; empty before its Hello."""
        nodes = list(self._recorder.nodes)
        hello = next((node.decoder.hello for node in nodes if node.name == self.node), None)
        return "" if hello is None else hello.serial.hex()

    def log_table_angle(self, angle: float, *, moving: bool) -> None:
        """Log the present angle of the turntable, rad, and whether it is moving."""
        self._computer.put(_TurntableRow(self._computer.now_ns(), angle, moving))

    def measure(self, duration: float) -> Samples:
        """Return the samples of the next `duration` s once all of them were received.

        Raises LinkError when the node falls silent, InputError when the port carries another node than
        requested, and any exception that ended the recording.
        """
        start = self.now()
        parts: list[tuple[Array, Array, Array]] = []
        last_received = self.now()
        while not parts or parts[-1][0][-1] < start + duration:
            if self._failure is not None:
                raise self._failure
            try:
                node, *block = self._log.imu_blocks.get(timeout=_QUEUE_TIMEOUT_S)
            except queue.Empty:
                if self.now() - last_received > _MAX_SILENCE_S:
                    raise LinkError(
                        f"{self._label}: no samples for {_MAX_SILENCE_S:.0f} s; is the node powered? "
                        f"run hubodo doctor"
                    ) from None
                continue
            last_received = self.now()
            if self.node is None:
                self.node = node
            if node != self.node:
                raise InputError(f"{self._label} carries node {node!r}, not {self.node!r}; see --node")
            t, gyro, accel = block
            is_inside = (t >= start) & (t < start + duration)
            if is_inside.any() or t[-1] >= start + duration:
                parts.append((t, gyro, accel))
        t, gyro, accel = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        is_inside = (t >= start) & (t < start + duration)
        return Samples(t[is_inside], gyro[is_inside], accel[is_inside])

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._run_once()
            while (item := self._computer.next_report(0.0)) is not None:
                self._handle_item(item)
            self._recorder.close()
        except Exception as error:  # noqa: BLE001 - raised by `measure`
            self._failure = error

    def _run_once(self) -> None:
        item = self._computer.next_report(_QUEUE_TIMEOUT_S)
        if item is not None:
            self._handle_item(item)
        self._recorder.tick(self._computer.now_ns())
        self._log.tick()
        for notice in self._recorder.notices:
            self._on_notice(notice.text)
        self._recorder.notices.clear()
        verdict: HubodoError | None = self._recorder.fatal_error()
        if verdict is not None:
            raise verdict

    def _handle_item(self, item: LinkReport | _TurntableRow) -> None:
        if isinstance(item, _TurntableRow):
            row = {"angle": [item.angle], "moving": [float(item.moving)]}
            self._log.write_columns("table", [item.t_ns], item.t_ns, row)
        else:
            self._recorder.handle(item)
