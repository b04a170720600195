"""A virtual wheel node: a motion goes in, the firmware's own bytes come out of a serial port."""

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

from hubodo.emulator.board.bus import Read
from hubodo.emulator.board.ether import Ether
from hubodo.emulator.board.process import BoardService, NodeSpec
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
from hubodo.emulator.chips.faults import ScriptedFault
from hubodo.emulator.chips.sampling import Truth
from hubodo.emulator.interpreters.interpreter import require
from hubodo.emulator.motion import Motion
from hubodo.errors import HubodoError
from hubodo.safe_text import json_text

_PROCESS = (sys.executable, "-m", "hubodo.emulator.board.process")
FIRMWARE_SUFFIXES = (".py", ".mpy", ".json")
_EMPTY, _SENSORS, _BOARD, _CLOCK, _HOST = Flash(), SensorBoard(), BoardSettings(), Clock(), Host()


class VirtualNodeError(HubodoError):
    """A virtual node that could not start, or ended by itself."""


@dataclass(frozen=True)
class ChipView:
    """One chip of a running node, from outside."""

    _node: VirtualNode
    _name: str

    def truth(self) -> Truth:
        """What the chip has made so far, sample by sample."""
        truth: Truth = self._node.command("truth", self._name)
        return truth


def fill_flash(flash: Flash, folder: Path) -> None:
    """Copy what belongs on a board from `flash.firmware` to `folder`, its config as config.json beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    if flash.firmware is not None:
        for source in sorted(flash.firmware.rglob("*")):
            if source.is_file() and source.suffix in FIRMWARE_SUFFIXES and "__pycache__" not in source.parts:
                target = folder / source.relative_to(flash.firmware)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(source, target)
    if flash.config is not None:
        (folder / "config.json").write_text(json_text(flash.config))


def _check(board: BoardSettings, clock: Clock, host: Host) -> None:
    """Raises what `VirtualNode` raises where something is missing or does not go together."""
    require(board.interpreter, board.pico.image, board.pico.bootrom)
    if board.emulated and host.link in ("uart", "udp"):
        raise ValueError(f"link {host.link}: an emulated Pico speaks over USB; want pty or memory")
    if board.emulated and clock.kind == "real":
        raise ValueError("an emulated Pico has a clock of its own: want clock stepped or paced")


class VirtualNode:
    """Emulated chips, board and link around the real firmware in a real interpreter.

    Args:
        motion: what the chips are moved through; its t = 0 is the moment of power-on.
        flash: the firmware, its settings, and where the board's file system is.
        sensors: the chips on its bus. board: which board, and what runs the firmware. clock: how its time
            runs. host: what is at the other end of its link. See `board.settings`.
        faults: what goes wrong and when, see `chips.faults`.
        seed: of the chips' disturbance and of the line's noise.
        own_process: run the board in a process of its own (two nodes use two cores), else in a thread.
        ether: the board has an nRF24L01+ on it; boards with the same one hear each other.

    Raises:
        InterpreterMissing: node or the npm package is absent.
        ImageMissing: the image of MicroPython for the Pico, or the bootrom.
        ValueError: settings that do not go together.
    """

    def __init__(
        self,
        motion: Motion,
        flash: Flash = _EMPTY,
        *,
        sensors: SensorBoard = _SENSORS,
        board: BoardSettings = _BOARD,
        clock: Clock = _CLOCK,
        host: Host = _HOST,
        faults: Sequence[ScriptedFault] = (),
        seed: int = 0,
        own_process: bool = True,
        ether: Ether | None = None,
    ) -> None:
        _check(board, clock, host)
        if ether is not None and (own_process or clock.kind == "real"):
            raise ValueError("boards on one ether share its time: want own_process=False, a virtual clock")
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
            ether=ether,
        )
        self._own_process = own_process
        self._connection: Connection | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        self.chip = ChipView(self, "imu")

    def start(self) -> VirtualNode:
        """Switch the board on; returns once its port is there."""
        if self._connection is not None:
            raise VirtualNodeError("virtual node is running already: stop it before it is started again")
        ours, theirs = Pipe()
        self._connection = ours
        if self._own_process:
            self._start_process(ours, theirs)
        else:
            self._start_thread(theirs)
        return self

    def _start_process(self, ours: Connection, theirs: Connection) -> None:
        environment = dict(os.environ, OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
        environment["PYTHONPATH"] = os.pathsep.join(p for p in sys.path if p)
        self._process = subprocess.Popen(
            [*_PROCESS, str(theirs.fileno()), str(os.getpid())],
            pass_fds=(theirs.fileno(),),
            env=environment,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
        theirs.close()
        ours.send(self._spec)
        try:
            failure = ours.recv()
        except EOFError:
            failure = VirtualNodeError("the board's process ended before it began; its message is on stderr")
        if failure is not None:
            self._finish()
            raise failure

    def _start_thread(self, theirs: Connection) -> None:
        service = BoardService(theirs, self._spec)
        service.board.running = True

        def run() -> None:
            service.run()
            theirs.close()

        self._thread = threading.Thread(target=run, name="virtual-board", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Switch off and give everything back; truth and stats are gone with it."""
        if self._connection is not None:
            with contextlib.suppress(HubodoError, OSError, EOFError):
                self.command("quit")
        self._finish()
        shutil.rmtree(self._scratch, ignore_errors=True)

    def _finish(self) -> None:
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
        """Until the board is off (`run_for`, or a failure); False when `timeout` s were not enough.

        Raises:
            HubodoError: what the board died of.
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
        """Ask the board's process; see `board.process.BoardService`."""
        with self._lock:
            self._say(name, *arguments)
            return self._hear()

    def live_until(self, t: float, heard: int) -> None:
        """With a led clock: begins to live until t, s, with the next so many bytes of its host."""
        self._say("live_until", t * 1e9, heard)

    def lived(self) -> list[tuple[int, int]]:
        """Once it has lived so far: (ns, bytes) of what it put on its port meanwhile.

        Raises:
            HubodoError: what the board died of.
        """
        written: list[tuple[int, int]] = self._hear()
        return written

    def _say(self, name: str, *arguments: object) -> None:
        if self._connection is None:
            raise VirtualNodeError("virtual node is not running: start it first")
        try:
            self._connection.send((name, arguments))
        except OSError as gone:
            raise self._gone(gone) from gone

    def _hear(self) -> Any:
        assert self._connection is not None
        try:
            reply = self._connection.recv()
        except (EOFError, OSError) as gone:
            raise self._gone(gone) from gone
        if isinstance(reply, HubodoError):
            raise reply
        return reply

    def _gone(self, error: Exception) -> VirtualNodeError:
        return VirtualNodeError(f"the board's process is gone ({error!r}); its message is on stderr")

    @property
    def port(self) -> str:
        """Path of the serial port: a link that follows the terminal through unplugging and resets."""
        return str(self.link_path)

    @property
    def flash(self) -> Path:
        """The host's folder that is the board's file system, as it is now."""
        if self._connection is not None:
            self.command("mirror_flash")
        return self._flash

    @property
    def stats(self) -> dict[str, Any]:
        """Counts of calls, link, bus and chips; resets with time and cause; processor time in s."""
        stats: dict[str, Any] = self.command("stats")
        return stats

    @property
    def output(self) -> bytes:
        """With link "memory": all bytes the board has sent."""
        output: bytes = self.command("output")
        return output

    def arrivals(self) -> list[tuple[float, int]]:
        """With link "memory": (s, bytes of `output` that had come by then)."""
        arrivals: list[tuple[float, int]] = self.command("arrivals")
        return arrivals

    def bus_log(self) -> list[Read]:
        """With `log` of the sensors: every read of the I2C bus."""
        log: list[Read] = self.command("bus_log")
        return log

    def meter(self) -> dict[str, Any]:
        """With an emulated Pico and its meter_from: what the processor did, see rp2040/meter.mjs."""
        meter: dict[str, Any] = self.command("meter")
        return meter

    def link_log(self) -> list[tuple[int, bytes, bytes, bool]]:
        """With `log` of the host: (host ns, bytes written, bytes after line noise, host was listening)."""
        log: list[tuple[int, bytes, bytes, bool]] = self.command("link_log")
        return log

    def unplug(self) -> None:
        """Pull the cable: the terminal vanishes, `port` points nowhere."""
        self.command("unplug")

    def replug(self) -> None:
        """Put the cable back: a new terminal, `port` points to it."""
        self.command("replug")

    def reset(self) -> None:
        """Pull the RUN pin."""
        self.command("reset")
