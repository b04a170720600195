"""A virtual wheel node: a motion goes in, the firmware's own bytes come out of a serial port."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

from hubodo.emulator.board.bus import Read
from hubodo.emulator.board.interpreter import Kind, find_micropython, find_node, find_rp2040js
from hubodo.emulator.board.process import IMUS, BoardService, ChipName, NodeSpec
from hubodo.emulator.board.rp2040.image import find_image
from hubodo.emulator.board.settings import BoardSettings
from hubodo.emulator.chips.faults import Fault
from hubodo.emulator.chips.imu import Disturbance, Part
from hubodo.emulator.chips.registers import Write
from hubodo.emulator.chips.sampling import Truth
from hubodo.emulator.motion import Motion, StillMotion
from hubodo.errors import HubodoError

_PROCESS = (sys.executable, "-m", "hubodo.emulator.board.process")
FIRMWARE_SUFFIXES = (".py", ".mpy", ".json")


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

    def writes(self) -> tuple[Write, ...]:
        """Every register write the chip accepted."""
        writes: tuple[Write, ...] = self._node.command("writes", self._name)
        return writes


def install_firmware(firmware: Path, flash: Path, config: Mapping[str, object] | None) -> None:
    """Copy what belongs on a board from `firmware` to `flash`, and `config` as config.json beside it."""
    for source in sorted(firmware.rglob("*")):
        if source.is_file() and source.suffix in FIRMWARE_SUFFIXES and "__pycache__" not in source.parts:
            target = flash / source.relative_to(firmware)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)
    if config is not None:
        (flash / "config.json").write_text(json.dumps(dict(config)))


class VirtualNode:
    """Emulated chips, board and link around the real firmware in a real interpreter.

    Args:
        motion: what the chips are moved through; its t = 0 is the moment of power-on.
        firmware: directory with main.py and what it imports; None leaves the board's flash as it is.
        config: written to /config.json of the board; None writes none.
        chip: which IMU sits on the bus. A LIS3MDL is beside it unless `magnetometer` is False.
        odr_error: the IMU's true rate is nominal * (1 + odr_error), within +-0.1.
        odr_per_degree: relative change of that rate per degC away from 25.
        disturbance: noise or bias added before quantisation, see `chips.imu.Disturbance`.
        seed: of that noise and of the line's.
        clock: "real" is the wall clock; "paced" keeps up with it but waits, chips included, where the machine
            is too busy, so that no load costs samples; "stepped" runs as fast as it can.
        interpreter: "micropython" (node and npm package needed), "cpython", or "rp2040": an emulated Pico
            that runs its own MicroPython (node, npm package and image needed, see `board.rp2040.image`).
        faults: what goes wrong and when, see `chips.faults`.
        link: "pty" USB CDC on a pseudo terminal; "uart" the same terminal on UART 0; "udp" the firmware
            sends by itself, the terminal is its console; "memory" no host, output is kept.
        link_path: where the symbolic link on the terminal of the moment shall be; made up when None.
        flash: host directory that is the board's file system, kept afterwards; a temporary one when None.
        corrupt, lose: probability per byte from the board that it is changed, or missing.
        own_process: run the board in a process of its own (two nodes use two cores), else in a thread.
        scripted_input: with link "memory", (s, bytes) that reach the board at these times.
        board: further BoardSettings by name (port, air, clock_ppm, ticks_start_us, heap_bytes, ...).

    Raises:
        InterpreterMissing: node or the npm package is absent.
        ImageMissing: the image of MicroPython for the Pico, or the bootrom.
        ValueError: an argument outside what is written above.
    """

    def __init__(
        self,
        motion: Motion,
        *,
        firmware: Path | None,
        config: Mapping[str, object] | None = None,
        chip: ChipName = "lsm6ds33",
        magnetometer: bool = True,
        odr_error: float = 0.0,
        odr_per_degree: float = 0.0,
        disturbance: Disturbance | None = None,
        seed: int = 0,
        clock: Literal["real", "paced", "stepped"] = "real",
        interpreter: Kind = "micropython",
        faults: Sequence[Fault] = (),
        link: Literal["pty", "uart", "udp", "memory"] = "pty",
        link_path: Path | None = None,
        flash: Path | None = None,
        who_am_i: int | None = None,
        strict: bool = True,
        corrupt: float = 0.0,
        lose: float = 0.0,
        keep_link_log: bool = False,
        keep_bus_log: bool = False,
        run_for: float | None = None,
        wait_for_host: bool = False,
        own_process: bool = True,
        scripted_input: Sequence[tuple[float, bytes]] = (),
        **board: Any,
    ) -> None:
        if interpreter == "micropython":
            find_node()
            find_micropython()
        elif interpreter == "rp2040":
            find_node()
            find_rp2040js()
            find_image(board.get("image"), board.get("bootrom"))
            if link in ("uart", "udp"):
                raise ValueError(f"link {link}: an emulated Pico speaks over USB; want pty or memory")
        self._folder = Path(tempfile.mkdtemp(prefix="hubodo-node-"))
        self._flash = flash if flash is not None else self._folder / "flash"
        self._flash.mkdir(parents=True, exist_ok=True)
        if firmware is not None:
            install_firmware(firmware, self._flash, config)
        elif config is not None:
            (self._flash / "config.json").write_text(json.dumps(dict(config)))
        self.link_path = link_path if link_path is not None else self._folder / "tty"
        if link == "uart":
            board.setdefault("uart_link", 0)
        settings = BoardSettings(
            flash=self._flash,
            interpreter=interpreter,
            clock=clock,
            run_for=run_for,
            wait_for_host=wait_for_host,
            **board,
        )
        part = Part(
            odr_error=odr_error,
            odr_per_degree=odr_per_degree,
            disturbance=disturbance,
            seed=seed,
            who_am_i=who_am_i,
            strict=strict,
            faults=tuple(faults),
        )
        self._spec = NodeSpec(
            motion=motion,
            part=part,
            chip=chip,
            magnetometer=magnetometer,
            settings=settings,
            link="memory" if link == "memory" else "pty",
            link_path=None if link == "memory" else self.link_path,
            scratch=self._folder,
            faults=tuple(faults),
            corrupt=corrupt,
            lose=lose,
            noise_seed=seed,
            keep_link_log=keep_link_log,
            keep_bus_log=keep_bus_log,
            scripted_input=tuple(scripted_input),
        )
        self._own_process = own_process
        self._connection: Connection | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        self.chip = ChipView(self, "imu")
        self.mag = ChipView(self, "mag")

    # ---- running ----

    def start(self) -> VirtualNode:
        """Switch the board on; returns once its port is there."""
        if self._connection is not None:
            raise VirtualNodeError("virtual node is running already: stop it before it is started again")
        ours, theirs = Pipe()
        self._connection = ours
        if self._own_process:
            environment = dict(os.environ, OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
            environment["PYTHONPATH"] = os.pathsep.join(p for p in sys.path if p)
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    "hubodo.emulator.board.process",
                    str(theirs.fileno()),
                    str(os.getpid()),
                ],
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
                failure = VirtualNodeError(
                    "the board's process ended before it began; its message is on stderr"
                )
            if failure is not None:
                self._finish()
                raise failure
        else:
            service = BoardService(theirs, self._spec)
            service.board.running = True

            def run() -> None:
                service.run()
                theirs.close()

            self._thread = threading.Thread(target=run, name="virtual-board", daemon=True)
            self._thread.start()
        return self

    def stop(self) -> None:
        """Switch off and give everything back; truth and stats are gone with it."""
        if self._connection is not None:
            with contextlib.suppress(HubodoError, OSError, EOFError):
                self.command("quit")
        self._finish()
        shutil.rmtree(self._folder, ignore_errors=True)

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

    def power_off(self) -> None:
        """Switch the board off but keep its chips' truth and its stats for questions."""
        self.command("stop")
        self.wait(10)

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

    # ---- looking and meddling ----

    def command(self, name: str, *arguments: object) -> Any:
        """Ask the board's process; see `board.process.BoardService`."""
        if self._connection is None:
            raise VirtualNodeError("virtual node is not running: start it first")
        with self._lock:
            try:
                self._connection.send((name, arguments))
                reply = self._connection.recv()
            except (EOFError, OSError) as gone:
                raise VirtualNodeError(
                    f"the board's process is gone ({gone!r}); its message is on stderr"
                ) from gone
        if isinstance(reply, HubodoError):
            raise reply
        return reply

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
        """With keep_bus_log: every read of the I2C bus."""
        log: list[Read] = self.command("bus_log")
        return log

    def meter(self) -> dict[str, Any]:
        """With interpreter "rp2040" and meter_from: what the processor did, see rp2040/meter.mjs."""
        meter: dict[str, Any] = self.command("meter")
        return meter

    def link_log(self) -> list[tuple[int, bytes, bytes, bool]]:
        """With keep_link_log: (host ns, bytes written, bytes after line noise, host was listening)."""
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


def main(arguments: Sequence[str] | None = None) -> int:
    """`python -m hubodo.emulator.virtual_node`: a node that lies still, until Ctrl-C; prints its port."""
    parser = argparse.ArgumentParser(
        prog="python -m hubodo.emulator.virtual_node",
        description="Run firmware on a virtual board that lies still.",
    )
    parser.add_argument("firmware", type=Path, nargs="?", help="directory with main.py; none = empty flash")
    parser.add_argument(
        "--link", type=Path, metavar="PATH", help="where to keep a symbolic link on the terminal"
    )
    parser.add_argument("--node-id", type=int, default=1)
    parser.add_argument(
        "--rate", type=int, default=208, metavar="HZ", help="rate_hz of the node (default 208)"
    )
    parser.add_argument("--chip", choices=sorted(IMUS), default="lsm6ds33")
    parser.add_argument("--spin", type=float, default=0.0, metavar="RAD_S", help="rate about z (default 0)")
    parser.add_argument("--interpreter", choices=("micropython", "cpython", "rp2040"), default="micropython")
    given = parser.parse_args(arguments)
    config = {"node_id": given.node_id, "rate_hz": given.rate} if given.firmware is not None else None
    try:
        with VirtualNode(
            StillMotion(rate=(0.0, 0.0, given.spin)),
            firmware=given.firmware,
            config=config,
            chip=given.chip,
            interpreter=given.interpreter,
            clock="paced" if given.interpreter == "rp2040" else "real",
            link_path=given.link,
        ) as node:
            print(node.port, flush=True)
            node.wait()
    except HubodoError as failure:
        print(failure, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
