"""One node's samples while they are recorded: for who moves something meanwhile and looks at what came."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from hubodo.arrays import Array
from hubodo.errors import HubodoError, InputError, LinkError
from hubodo.ingest.link.link import LinkReport
from hubodo.ingest.link.ports import attach_keys, list_devices, parse_port
from hubodo.ingest.live.computer import Computer, ThisComputer
from hubodo.ingest.live.recorder import Recorder
from hubodo.log.log_writer import LogWriter
from hubodo.units import NS_PER_S
from hubowire.budget import UART_BAUD

_TICK_S = 0.02
_SILENCE_S = 8.0
"""A node that has said nothing for so long says nothing any more; a start with its clock takes two."""


@dataclass(frozen=True)
class Samples:
    """t: (N,) s since the log's start. gyro: (N, 3) rad/s; accel: (N, 3) m/s², node axes."""

    t: Array
    gyro: Array
    accel: Array


@dataclass(frozen=True)
class _TableRow:
    t_ns: int
    angle: float
    moving: bool


class _KeepingLog(LogWriter):
    """A log that also keeps in memory what was measured, until it is asked for."""

    def __init__(
        self, path: Path, *, t_zero_ns: int, metadata: Mapping[str, str], clock: Callable[[], int]
    ) -> None:
        super().__init__(path, t_zero_ns=t_zero_ns, metadata=metadata, clock=clock)
        self.kept: queue.SimpleQueue[tuple[str, Array, Array, Array]] = queue.SimpleQueue()
        self._zero_ns = t_zero_ns

    def write_imu(
        self, node: str, t_pub_ns: ArrayLike, t_log_ns: ArrayLike, gyro: ArrayLike, accel: ArrayLike
    ) -> None:
        """As a log, and kept."""
        super().write_imu(node, t_pub_ns, t_log_ns, gyro, accel)
        t = np.asarray((np.asarray(t_pub_ns, np.int64) - self._zero_ns) * 1e-9, np.float64)
        self.kept.put((node, t, np.asarray(gyro, np.float64), np.asarray(accel, np.float64)))


class NodeStream:
    """Records the node on a port into a log from a thread of its own; a context manager.

    port: as `hubodo record` takes it. out: the log. node: its name, None for the only one on the port. say:
    gets the lines that a user should see. computer: None, the one on which this runs. Raises InputError when
    `out` exists or the port cannot be opened.
    """

    def __init__(
        self,
        port: str,
        out: Path,
        *,
        node: str | None = None,
        baud: int = UART_BAUD,
        metadata: Mapping[str, str] | None = None,
        say: Callable[[str], None] = lambda line: None,
        computer: Computer | None = None,
    ) -> None:
        if out.exists():
            raise InputError(f"{out}: exists already; choose another name, nothing is overwritten")
        self.node = node
        self._say = say
        self._computer = computer or ThisComputer()
        self._zero_ns = self._computer.now_ns() // NS_PER_S * NS_PER_S
        name = attach_keys(parse_port(port), None, insecure=False)
        self._label = name.label
        self._link = self._computer.link(name, name.label, baud, list_devices)
        try:
            self._link.open_now()
        except LinkError as error:
            raise InputError(str(error)) from None
        clock = self._computer.now_ns
        self._log = _KeepingLog(out, t_zero_ns=self._zero_ns, metadata=metadata or {}, clock=clock)
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
            self._log.path.unlink()  # no node was there

    def now(self) -> float:
        """s since the log's start, on its clock."""
        return (self._computer.now_ns() - self._zero_ns) * 1e-9

    @property
    def serial(self) -> str:
        """Of the node, "" before it has said so."""
        nodes = list(self._recorder.nodes.values())
        hello = next((node.decoder.hello for node in nodes if node.name == self.node), None)
        return "" if hello is None else hello.serial.hex()

    def table(self, angle: float, *, moving: bool) -> None:
        """A row of the log's turntable: its angle, rad, from now on."""
        self._computer.put(_TableRow(self._computer.now_ns(), angle, moving))

    def measure(self, duration: float) -> Samples:
        """What is measured in the next `duration` s; returns once all of it has come.

        Raises LinkError when the node falls silent, InputError when another than the one named speaks, and
        whatever the recording failed with.
        """
        begin = self.now()
        parts: list[tuple[Array, Array, Array]] = []
        heard = self.now()
        while not parts or parts[-1][0][-1] < begin + duration:
            if self._failure is not None:
                raise self._failure
            try:
                node, *block = self._log.kept.get(timeout=_TICK_S)
            except queue.Empty:
                if self.now() - heard > _SILENCE_S:
                    raise LinkError(
                        f"{self._label}: no samples for {_SILENCE_S:.0f} s; is the node powered? "
                        f"hubodo doctor says more"
                    ) from None
                continue
            heard = self.now()
            if self.node is None:
                self.node = node
            if node != self.node:
                raise InputError(f"{self._label} carries node {node!r}, asked for {self.node!r}; see --node")
            t, gyro, accel = block
            inside = (t >= begin) & (t < begin + duration)
            if inside.any() or t[-1] >= begin + duration:
                parts.append((t, gyro, accel))
        t, gyro, accel = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        inside = (t >= begin) & (t < begin + duration)
        return Samples(t[inside], gyro[inside], accel[inside])

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._turn()
            while (item := self._computer.news(0.0)) is not None:
                self._take(item)
            self._recorder.close()
        except Exception as error:  # noqa: BLE001 - raised where somebody waits for samples
            self._failure = error

    def _turn(self) -> None:
        item = self._computer.news(_TICK_S)
        if item is not None:
            self._take(item)
        self._recorder.tick(self._computer.now_ns())
        self._log.tick()
        for notice in self._recorder.notices:
            self._say(notice.text)
        self._recorder.notices.clear()
        verdict: HubodoError | None = self._recorder.verdict()
        if verdict is not None:
            raise verdict

    def _take(self, item: LinkReport | _TableRow) -> None:
        if isinstance(item, _TableRow):
            row = {"angle": [item.angle], "moving": [float(item.moving)]}
            self._log.write_columns("table", [item.t_ns], item.t_ns, row)
        else:
            self._recorder.handle(item)
