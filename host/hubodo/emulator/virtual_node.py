"""A virtual node: the real firmware on an emulated board and chips, behind a serial port."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any

from hubodo.emulator.board.bus import BusRead
from hubodo.emulator.board.process import BoardService, NodeSpec
from hubodo.emulator.board.radio_medium import RadioMedium
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
from hubodo.emulator.chips.catalogue import imu_by_name
from hubodo.emulator.chips.faults import ScriptedFault
from hubodo.emulator.chips.sampling import ChipSamples
from hubodo.emulator.interpreters.interpreter import check_available
from hubodo.emulator.motion import Motion
from hubodo.errors import HubodoError
from hubodo.safe_text import json_text

_BOARD_COMMAND = (sys.executable, "-m", "hubodo.emulator.board.process")
FIRMWARE_SUFFIXES = (".py", ".mpy", ".json")
_DEFAULT_FLASH, _DEFAULT_SENSORS, _DEFAULT_BOARD, _DEFAULT_CLOCK, _DEFAULT_HOST = (
    Flash(),
    SensorBoard(),
    BoardSettings(),
    Clock(),
    Host(),
)


class VirtualNodeError(HubodoError):
    """A virtual node could not start, or ended unexpectedly."""


@dataclass(frozen=True)
class ChipView:
    """Access to one chip of a running node."""

    _node: VirtualNode
    _name: str

    def truth(self) -> ChipSamples:
        """Return all samples of the chip so far."""
        truth: ChipSamples = self._node.command("truth", self._name)
        return truth


def fill_flash(flash: Flash, folder: Path) -> None:
    """Copy the firmware to `folder`, with the configuration as config.json."""
    folder.mkdir(parents=True, exist_ok=True)
    if flash.firmware is not None:
        shutil.copytree(
            flash.firmware,
            folder,
            ignore=_ignored_names,
            copy_function=shutil.copyfile,
            dirs_exist_ok=True,
        )
    if flash.config is not None:
        (folder / "config.json").write_text(json_text(flash.config))


def _ignored_names(folder: str, names: list[str]) -> list[str]:
    """Return the names in a folder of firmware that a board does not get."""
    return [
        name
        for name in names
        if name == "__pycache__"
        or (Path(name).suffix not in FIRMWARE_SUFFIXES and not Path(folder, name).is_dir())
    ]


def _check(board: BoardSettings, clock: Clock, host: Host, sensors: SensorBoard) -> None:
    """Raise an error of `VirtualNode` if something is missing or the settings contradict each other."""
    imu_by_name(sensors.chip)
    check_available(board.interpreter, board.pico.image, board.pico.bootrom)
    if board.is_emulated and host.link in ("uart", "udp"):
        raise ValueError(f"link {host.link}: an emulated Pico uses USB; choose pty or memory")
    if board.is_emulated and clock.kind == "real":
        raise ValueError("an emulated Pico has its own clock: choose clock stepped or paced")


class VirtualNode:
    """Emulated chips, board and link around the real firmware in a real interpreter.

    Parameters
    ----------
    motion : motion of the chips; its t = 0 is power-on.
    flash : firmware, its settings, and the location of the file system.
    sensors, board, clock, host : chips on the bus, board and interpreter, time, and other end of the link;
        see `board.settings`.
    faults : scripted faults, see `chips.faults`.
    seed : seed of the disturbance of the chips and of the line noise.
    own_process : True to run the board in its own process (two nodes use two cores), else in a thread.
    radio_medium : radio medium; the board has an nRF24L01+, and boards on the same medium receive each other.

    Raises
    ------
    InterpreterMissing
        If node or the npm package is missing.
    ImageMissing
        If the MicroPython image for the Pico, or the bootrom, is missing.
    ValueError
        If the settings contradict each other.
    """

    def __init__(
        self,
        motion: Motion,
        flash: Flash = _DEFAULT_FLASH,
        *,
        sensors: SensorBoard = _DEFAULT_SENSORS,
        board: BoardSettings = _DEFAULT_BOARD,
        clock: Clock = _DEFAULT_CLOCK,
        host: Host = _DEFAULT_HOST,
        faults: Sequence[ScriptedFault] = (),
        seed: int = 0,
        own_process: bool = True,
        radio_medium: RadioMedium | None = None,
    ) -> None:
        _check(board, clock, host, sensors)
        if radio_medium is not None and (own_process or clock.kind == "real"):
            raise ValueError(
                "boards on one radio medium share its time: use own_process=False and a virtual clock"
            )
        self._scratch = Path(tempfile.mkdtemp(prefix="hubodo-node-"))
        self._flash = flash.folder if flash.folder is not None else self._scratch / "flash"
        fill_flash(flash, self._flash)
        self.link_path = host.path if host.path is not None else self._scratch / "tty"
        if host.link == "uart" and board.uart_link is None:
            board = replace(board, uart_link=0)
        self._spec = NodeSpec(
            motion=motion,
            flash=replace(flash, folder=self._flash),
            sensors=sensors,
            board=board,
            clock=clock,
            host=replace(host, path=self.link_path),
            faults=tuple(faults),
            seed=seed,
            scratch=self._scratch,
            radio_medium=radio_medium,
        )
        self._own_process = own_process
        self._connection: Connection | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        self.chip = ChipView(self, "imu")

    def start(self) -> VirtualNode:
        """Switch the board on; return when its port exists."""
        if self._connection is not None:
            raise VirtualNodeError("the virtual node is running already: stop it first")
        our_end, board_end = Pipe()
        self._connection = our_end
        if self._own_process:
            self._start_process(our_end, board_end)
        else:
            self._start_thread(board_end)
        return self

    def _start_process(self, our_end: Connection, board_end: Connection) -> None:
        """Start the board in its own process, and send it the specification."""
        environment = dict(os.environ, OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
        environment["PYTHONPATH"] = os.pathsep.join(p for p in sys.path if p)
        self._process = subprocess.Popen(
            [*_BOARD_COMMAND, str(board_end.fileno()), str(os.getpid())],
            pass_fds=(board_end.fileno(),),
            env=environment,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
        board_end.close()
        our_end.send(self._spec)
        try:
            failure = our_end.recv()
        except EOFError:
            failure = VirtualNodeError(
                "the process of the board ended at its start; its message is on stderr"
            )
        if failure is not None:
            self._finish()
            raise failure

    def _start_thread(self, board_end: Connection) -> None:
        """Start the board in a thread."""
        service = BoardService(board_end, self._spec)
        service.board.running = True

        def run() -> None:
            try:
                service.run()
            finally:
                # A caller that waits for a board that failed gets an error instead of waiting forever.
                board_end.close()

        self._thread = threading.Thread(target=run, name="virtual-board", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Switch the board off and release all resources; its records are lost."""
        if self._connection is not None:
            with contextlib.suppress(HubodoError, OSError, EOFError):
                self.command("quit")
        self._finish()
        shutil.rmtree(self._scratch, ignore_errors=True)

    def _finish(self) -> None:
        """Close the connection, and end process and thread."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        if self._process is not None:
            try:
                self._process.wait(5)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            self._process = None
        if self._thread is not None:
            self._thread.join(5)
            self._thread = None

    def __enter__(self) -> VirtualNode:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the board is off; return False after `timeout` s.

        Raise HubodoError if the board failed.
        """
        end = None if timeout is None else time.monotonic() + timeout
        while True:
            running, failure = self.command("state")
            if failure is not None:
                raise failure
            if not running:
                return True
            if end is not None and time.monotonic() > end:
                return False
            time.sleep(0.02)

    def command(self, name: str, *arguments: object) -> Any:
        """Send a command to the board and return its reply; see `board.process.BoardService`."""
        with self._lock:
            self._send(name, *arguments)
            return self._receive()

    def run_until(self, t: float, host_bytes: int) -> None:
        """Let a board with a lockstep clock run until t, s, with the next `host_bytes` bytes of its host."""
        self._send("run_until", t * 1e9, host_bytes)

    def wait_for_limit(self) -> list[tuple[int, int]]:
        """Wait until the board has reached its limit; return (ns, bytes) of its output.

        Raise HubodoError if the board failed.
        """
        written: list[tuple[int, int]] = self._receive()
        return written

    def _send(self, name: str, *arguments: object) -> None:
        if self._connection is None:
            raise VirtualNodeError("virtual node is not running: start it first")
        try:
            self._connection.send((name, arguments))
        except OSError as error:
            raise self._connection_lost(error) from error

    def _receive(self) -> Any:
        """Receive a reply; raise it if it is an error."""
        assert self._connection is not None
        try:
            reply = self._connection.recv()
        except (EOFError, OSError) as error:
            raise self._connection_lost(error) from error
        if isinstance(reply, HubodoError):
            raise reply
        return reply

    def _connection_lost(self, error: Exception) -> VirtualNodeError:
        """Return the error of a lost connection."""
        return VirtualNodeError(f"the process of the board has ended ({error!r}); its message is on stderr")

    @property
    def port(self) -> str:
        """Path of the serial port: a link that follows the terminal through unplugging and resets."""
        return str(self.link_path)

    @property
    def flash(self) -> Path:
        """Host folder with the current file system of the board."""
        if self._connection is not None:
            self.command("mirror_flash")
        return self._flash

    @property
    def stats(self) -> dict[str, Any]:
        """Counters of calls, link, bus and chips; resets with time and cause; processor time in s."""
        stats: dict[str, Any] = self.command("stats")
        return stats

    @property
    def output(self) -> bytes:
        """All bytes that the board has sent, with link "memory"."""
        output: bytes = self.command("output")
        return output

    def arrivals(self) -> list[tuple[float, int]]:
        """Return (s, bytes of `output` up to then) for each write, with link "memory"."""
        arrivals: list[tuple[float, int]] = self.command("arrivals")
        return arrivals

    def bus_log(self) -> list[BusRead]:
        """Return every read of the I2C bus, with `log` of the sensors."""
        log: list[BusRead] = self.command("bus_log")
        return log

    def meter(self) -> dict[str, Any]:
        """Return the activity profile of an emulated Pico with `meter_from`, see rp2040/meter.mjs."""
        meter: dict[str, Any] = self.command("meter")
        return meter

    def link_writes(self) -> list[tuple[int, bytes, bytes, bool]]:
        """Return (host ns, bytes written, bytes after line noise, host was listening), with `Host.log`."""
        log: list[tuple[int, bytes, bytes, bool]] = self.command("link_writes")
        return log

    def unplug(self) -> None:
        """Unplug the cable: the terminal vanishes, and `port` is a dangling link."""
        self.command("unplug")

    def replug(self) -> None:
        """Plug the cable in again: `port` points to a new terminal."""
        self.command("replug")

    def reset(self) -> None:
        """Pull the RUN pin low: the processor restarts."""
        self.command("reset")
