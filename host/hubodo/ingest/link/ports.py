"""Parsing of port names given by the user, and the search for the device behind one."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from ipaddress import ip_address
from pathlib import Path
from typing import Protocol
from urllib.parse import urlsplit

from serial.tools import list_ports

from hubodo.errors import InputError, LinkError
from hubodo.extras import require_extra
from hubodo.ingest.link.keys import KeyRing
from hubodo.ingest.link.topic_name import TOPIC_KIND, is_topic, is_valid_topic

_BY_ID_FOLDER = Path("/dev/serial/by-id")
_NAMED_PORT = re.compile(r"(?P<name>[A-Za-z][\w-]*)=(?P<port>.+)")
_SERIAL_NUMBER = re.compile(r"[\w.:-]+")
BLE_KIND = "ble"
_WINDOWS_PORT = re.compile(r"(\\\\\.\\)?COM\d+", re.IGNORECASE)


class PortInfo(Protocol):
    """The attributes of pyserial's ListPortInfo that are used."""

    device: str
    serial_number: str | None


DeviceLister = Callable[[], Iterable[PortInfo]]


def list_devices() -> list[PortInfo]:
    """Return the serial ports of this machine."""
    return list(list_ports.comports())


@dataclass(frozen=True, slots=True)
class PortName:
    """A port as given by the user: ``[NAME=]`` and a device, USB serial number, address or ROS 2 topic.

    Attributes
    ----------
    text
        The argument as given.
    name
        Name of the node on this port; None to derive it from the node id.
    kind
        "device", "serial number", "tcp", "udp", "ble" or "ros2".
    target
        Path, serial number, "host:port", name or address of a Bluetooth node, or topic.
    keys
        Keys that authenticate the packets of nodes on UDP or Bluetooth; None to accept packets without keys.
    """

    text: str
    name: str | None
    kind: str
    target: str
    keys: KeyRing | None = None

    @property
    def label(self) -> str:
        """Short name for status lines and topics: letters, digits, ``_`` and ``-``."""
        if self.name:
            return self.name
        tail = re.split(r"[/\\]", self.target)[-1] if self.kind == "device" else self.target
        return re.sub(r"[^\w-]+", "_", tail).strip("_") or "link"

    @property
    def address(self) -> tuple[str, int]:
        """Host and port number of a tcp or udp address."""
        host, _, port = self.target.rpartition(":")
        return host, int(port)


def parse_port(text: str) -> PortName:
    """Parse a port argument.

    Raises InputError when it is none of these kinds.
    """
    match = _NAMED_PORT.fullmatch(text)
    name, port = (match["name"], match["port"]) if match else (None, text)
    if is_topic(port):
        topic = port.removeprefix(f"{TOPIC_KIND}:")
        if not is_valid_topic(topic):
            raise InputError(
                f"port {text!r}: write ros2:/TOPIC with a name that ROS 2 allows, such as /left/imu"
            )
        return PortName(text, name, TOPIC_KIND, topic)
    scheme, has_scheme, _ = port.partition("://")
    if scheme == BLE_KIND and has_scheme:
        target = port.removeprefix(f"{BLE_KIND}://")
        if not _SERIAL_NUMBER.fullmatch(target):
            raise InputError(f"port {text!r}: write ble://NAME, such as ble://hubodo-1")
        return PortName(text, name, BLE_KIND, target)
    if has_scheme:
        kind = {"socket": "tcp", "udp": "udp"}.get(scheme)
        if kind is None:
            raise InputError(
                f"port {text!r}: unknown scheme {scheme}://; write socket://HOST:PORT, udp://HOST:PORT, "
                "ble://NAME or ros2:/TOPIC"
            )
        try:
            parts = urlsplit(port)
            host, number = parts.hostname, parts.port
        except ValueError:
            host, number = None, None
        if host is None or number is None:
            raise InputError(f"port {text!r}: host or port number is missing; write {scheme}://HOST:PORT")
        return PortName(text, name, kind, f"{host}:{number}")
    if "/" in port or _WINDOWS_PORT.fullmatch(port):
        return PortName(text, name, "device", port)
    if port and _SERIAL_NUMBER.fullmatch(port):
        return PortName(text, name, "serial number", port)
    raise InputError(
        f"port {text!r}: write a device such as /dev/ttyACM0 or COM3, a USB serial number, socket://, "
        "udp://, ble://NAME or ros2:/TOPIC"
    )


def attach_keys(port: PortName, key_file: Path | None, *, insecure: Collection[str]) -> PortName:
    """Return the port, for UDP and Bluetooth with the keys of its nodes.

    Raises InputError for a port that accepts packets of other machines without keys, unless its kind is in
    `insecure`: anybody on the network, or within reach of the radio, could send samples to it; also for
    Bluetooth without the extra that it needs.
    """
    if port.kind not in ("udp", BLE_KIND):
        return port
    if port.kind == BLE_KIND:
        require_extra("ble", f"port {port.text!r}")
    if key_file is not None:
        return replace(port, keys=KeyRing(key_file))
    if port.kind in insecure or (port.kind == "udp" and _is_loopback(port.address[0])):
        return port
    place, option = (
        ("on the network", "--insecure-udp") if port.kind == "udp" else ("nearby", "--insecure-ble")
    )
    raise InputError(
        f"port {port.text!r}: anybody {place} could send samples there; give the --key-file of "
        f"`hubodo flash`, or {option} to accept samples from anybody"
    )


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class DeviceFinder:
    """Search for the device of a port, also after its name has changed.

    A port given by path is searched by that path first, later by the USB serial number read then.
    """

    def __init__(self, port: PortName, lister: DeviceLister = list_devices) -> None:
        self._port = port
        self._lister = lister
        self._serial_number = port.target if port.kind == "serial number" else None
        self._listing_error = ""

    def find_device(self) -> str:
        """Return the current path of the device.

        Raises LinkError when the device is not present.
        """
        if self._serial_number is not None:
            path = self._find_by_serial_number(self._serial_number)
            if path is not None:
                return path
            if self._port.kind == "serial number":
                if Path(self._serial_number).exists():
                    raise LinkError(
                        f"{self._serial_number}: is a file, and a port is due here; "
                        "`hubodo play FILE.mcap` replays a log"
                    )
                raise LinkError(
                    f"no device with serial number {self._serial_number!r}; plug it in, "
                    f"or choose one of the devices present: {self._devices_text()}"
                )
        path = self._port.target
        if not self._is_present(path):
            raise LinkError(f"{path}: no such device; plug it in, or choose one of: {self._devices_text()}")
        if self._serial_number is None:
            self._serial_number = self._read_serial_number(path)
        return path

    def _is_present(self, path: str) -> bool:
        if _WINDOWS_PORT.fullmatch(path):  # not a file
            return any(
                info.device.lower() == path.lower().removeprefix("\\\\.\\") for info in self._list_devices()
            )
        return Path(path).exists()

    def _find_by_serial_number(self, number: str) -> str | None:
        for info in self._list_devices():
            if info.serial_number and info.serial_number.lower() == number.lower():
                return info.device
        if _BY_ID_FOLDER.is_dir():
            with contextlib.suppress(OSError):  # the folder disappears with its last device
                for link in sorted(_BY_ID_FOLDER.iterdir()):
                    if f"_{number}-".lower() in link.name.lower():
                        return str(link)
        return None

    def _read_serial_number(self, path: str) -> str | None:
        real = os.path.realpath(path)
        for info in self._list_devices():
            if os.path.realpath(info.device) == real:
                return info.serial_number
        return None

    def _list_devices(self) -> list[PortInfo]:
        """Return the serial ports of this machine; an empty list where the system fails to list them."""
        self._listing_error = ""
        try:
            return list(self._lister())
        except Exception as error:  # noqa: BLE001 pyserial passes on any error of /sys or the registry
            self._listing_error = f"the serial ports cannot be listed: {type(error).__name__}: {error}"
            return []

    def _devices_text(self) -> str:
        devices = [f"{info.device} ({info.serial_number or 'no number'})" for info in self._list_devices()]
        return ", ".join(devices) or self._listing_error or "no serial port found"
