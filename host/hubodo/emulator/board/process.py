"""A virtual board in its own process or thread, controlled over a connection."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from hubodo.emulator.board.board import VirtualBoard
from hubodo.emulator.board.hypercall import Op
from hubodo.emulator.board.link import HostLink, LineNoise, MemoryLink, PtyLink
from hubodo.emulator.board.models import MODELS
from hubodo.emulator.board.peripherals import SPI_BYTE_NS
from hubodo.emulator.board.radio import RadioModule
from hubodo.emulator.board.radio_medium import RadioMedium
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
from hubodo.emulator.board.spi_sensor import SpiSensor
from hubodo.emulator.chips.adxl375 import Adxl375
from hubodo.emulator.chips.catalogue import MAG_CHIPS, imu_by_name
from hubodo.emulator.chips.faults import ScriptedFault, WrongWhoAmI
from hubodo.emulator.chips.registers import RegisterChip
from hubodo.emulator.motion import Motion
from hubodo.errors import HubodoError
from hubodo.units import NS_PER_S


@dataclass(frozen=True)
class NodeSpec:
    """Specification of a board; picklable. scratch: temporary folder that is removed with the board."""

    motion: Motion
    flash: Flash
    sensors: SensorBoard
    board: BoardSettings
    clock: Clock
    host: Host
    faults: tuple[ScriptedFault, ...]
    seed: int
    scratch: Path
    radio_medium: RadioMedium | None = None


def build_board(spec: NodeSpec) -> tuple[VirtualBoard, dict[str, RegisterChip]]:
    """Build a board and its chips by name."""
    sensors, host = spec.sensors, spec.host
    # A chip that reports the identity of another is accessed by the driver of the other; its undocumented
    # accesses are then answered as silicon does, and raise no error.
    has_own_identity = sensors.specimen.who_am_i is None and not any(
        isinstance(fault, WrongWhoAmI) for fault in spec.faults
    )
    specimen = replace(sensors.specimen, seed=spec.seed, faults=spec.faults, strict=has_own_identity)
    imu = imu_by_name(sensors.chip)(spec.motion, specimen)
    chips: dict[str, RegisterChip] = {"imu": imu}
    if sensors.magnetometer:
        chips["mag"] = MAG_CHIPS[sensors.magnetometer_chip](spec.motion, specimen)
    if sensors.high_g:
        chips["high_g"] = Adxl375(spec.motion, specimen)
    link: HostLink = (
        MemoryLink(host.script, host.read_pauses) if host.link == "memory" else PtyLink(host.path)
    )
    on_i2c = list(chips.values())
    spi_sensor = None
    if sensors.select_pin is not None:
        on_i2c.remove(imu)
        spi_sensor = SpiSensor(imu, sensors.select_pin, SPI_BYTE_NS / NS_PER_S)
    board = VirtualBoard(
        spec.board,
        spec.clock,
        spec.flash,
        on_i2c,
        link,
        LineNoise(host.corrupt, host.lose, spec.seed),
        wiring=sensors.wiring,
        interrupts={} if sensors.interrupt_pin is None else {sensors.interrupt_pin: imu.interrupt_level},
        wait_for_host=host.wait,
        faults=spec.faults,
        spi_sensor=spi_sensor,
        radio=None
        if spec.radio_medium is None
        else RadioModule(
            spec.radio_medium,
            bytes.fromhex(spec.board.unique_id)[:6],
            MODELS[spec.board.model].platform,
        ),
    )
    if host.log:
        board.streams.log = []
    if sensors.log:
        board.bus.reads = []
    return board, chips


class BoardService:
    """Server of a board: it runs the board and handles the commands of a connection."""

    def __init__(self, connection: Connection, spec: NodeSpec) -> None:
        self._connection = connection
        self._scratch = spec.scratch
        self._cpu_at_start = _own_cpu()
        self.board, self.chips = build_board(spec)
        self.board.lockstep.on_limit_reached = self._report_limit_reached
        self._quit = self._awaiting_limit = False

    def run(self) -> None:
        """Run the board until the quit command or the end of the connection; report a fatal error there."""
        error: HubodoError | None = None
        try:
            self.board.serve(self._connection.fileno(), self._command)
        except HubodoError as failure:
            error = failure
        self._failure = error
        self._report_limit_reached()
        while not self._quit:
            self._command()
        self.board.streams.link.close()
        shutil.rmtree(self._scratch, ignore_errors=True)

    _failure: HubodoError | None = None

    def _command(self) -> None:
        """Receive a command and reply to it."""
        try:
            name, arguments = self._connection.recv()
        except (EOFError, OSError):
            self._quit = True
            self.board.stop()
            return
        if name == "run_until":
            self._awaiting_limit = True
            self.board.lockstep.allow_until(*arguments)
            if not self.board.running:
                self._report_limit_reached()
            return
        if name == "quit":
            self._quit = True
            self.board.stop()
            self._reply(None)
            return
        try:
            self._reply(getattr(self, f"_do_{name}")(*arguments))
        except HubodoError as failure:
            self._reply(failure)

    def _report_limit_reached(self) -> None:
        """Reply that the board has reached its time limit or has ended; later calls do nothing."""
        if self._awaiting_limit:
            self._awaiting_limit = False
            self._reply(self._failure or self.board.lockstep.pop_output())

    def _reply(self, value: object) -> None:
        """Send a value over the connection."""
        try:
            self._connection.send(value)
        except OSError:
            self._quit = True

    def _do_state(self) -> tuple[bool, HubodoError | None]:
        return self.board.running, self._failure

    def _do_stop(self) -> None:
        self.board.stop()

    def _do_truth(self, chip: str) -> object:
        return self.chips[chip].truth()  # type: ignore[attr-defined]

    def _do_unplug(self) -> None:
        self.board.unplug()

    def _do_replug(self) -> None:
        self.board.plug()

    def _do_reset(self) -> None:
        self.board.reset("reset pin")

    def _do_output(self) -> bytes:
        link = self.board.streams.link
        return bytes(link.output) if isinstance(link, MemoryLink) else b""

    def _do_arrivals(self) -> object:
        link = self.board.streams.link
        return link.arrivals if isinstance(link, MemoryLink) else []

    def _do_bus_log(self) -> object:
        return self.board.bus.reads

    def _do_meter(self) -> object:
        return self.board.profile

    def _do_mirror_flash(self) -> None:
        self.board.processor.mirror_flash()

    def _do_link_writes(self) -> object:
        return self.board.streams.log

    def _do_stats(self) -> dict[str, Any]:
        board = self.board
        return {
            "t": board.seconds,
            "running": board.running,
            "counts": {"calls": board.calls.total(), **board.counts},
            "calls": {Op(op).name: n for op, n in board.calls.items()},
            "link": dict(board.streams.link.counts),
            "noise": dict(board.streams.noise.counts),
            "bus": dict(board.bus.counts),
            "chips": {name: dict(chip.anomalies) for name, chip in self.chips.items()},
            "resets": list(board.resets),
            "interpreter_cpu": board.processor.cpu,
            "interpreter_pid": board.processor.pid,
            "board_cpu": _own_cpu() - self._cpu_at_start,
            "fifo_dropped": getattr(self.chips["imu"], "fifo_dropped", 0),
        }


def _own_cpu() -> float:
    """Return the processor time of this process, s."""
    return time.process_time()


def watch_parent(parent: int) -> None:
    """Exit this process when its parent has ended without closing the connection."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="parent").start()


def main(arguments: Sequence[str]) -> int:
    """Run `python -m hubodo.emulator.board.process FD PARENT`; the specification is received first."""
    connection = Connection(int(arguments[0]))
    watch_parent(int(arguments[1]))
    # Higher priority, where permitted, keeps the emulated chips from overflowing on a busy host.
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, -10)
    try:
        spec = connection.recv()
        service = BoardService(connection, spec)
    except (HubodoError, EOFError) as failure:
        connection.send(failure)
        return 1
    connection.send(None)
    service.run()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
