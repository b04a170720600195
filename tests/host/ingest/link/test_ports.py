"""Port names, search of devices by serial number, identification of foreign bytes."""

from dataclasses import dataclass

import pytest

from hubodo.errors import InputError, LinkError
from hubodo.ingest.link.foreign_bytes import describe_foreign_bytes
from hubodo.ingest.link.link import Chunk, LinkUp
from hubodo.ingest.link.ports import DeviceFinder, parse_port
from hubodo.ingest.link.session import LinkSession
from hubodo.units import NS_PER_S


@dataclass
class Device:
    """A serial device in the list of ports."""

    device: str
    serial_number: str | None


class Discards:
    """A sink that discards all records."""

    def write_record(self, record):
        pass


@pytest.mark.parametrize(
    ("text", "name", "kind", "where", "label"),
    [
        ("/dev/ttyACM0", None, "device", "/dev/ttyACM0", "ttyACM0"),
        ("left=/dev/ttyACM0", "left", "device", "/dev/ttyACM0", "left"),
        ("E660:58-3", None, "serial number", "E660:58-3", "E660_58-3"),
        ("right=E66058388347", "right", "serial number", "E66058388347", "right"),
        ("socket://host.example:4000", None, "tcp", "host.example:4000", "host_example_4000"),
        ("rear=udp://0.0.0.0:9000", "rear", "udp", "0.0.0.0:9000", "rear"),
        ("/dev/by-id/usb-A=B_1-if00", None, "device", "/dev/by-id/usb-A=B_1-if00", "usb-A_B_1-if00"),
    ],
)  # fmt: skip
def test_each_kind_of_port_is_understood(text, name, kind, where, label):
    port = parse_port(text)
    assert (port.name, port.kind, port.target, port.label) == (name, kind, where, label)


@pytest.mark.parametrize("text", ["", "left=", "http://x:1", "socket://x", "udp://:5", "socket://h:x", "a b"])
def test_an_invalid_port_is_refused_with_the_valid_forms(text):
    with pytest.raises(InputError, match="write"):
        parse_port(text)


def test_a_device_is_found_under_another_name_by_its_serial_number(tmp_path):
    first, second = tmp_path / "ttyACM0", tmp_path / "ttyACM1"
    first.touch()
    devices = [Device(str(first), "E661")]
    finder = DeviceFinder(parse_port(str(first)), lambda: devices)
    assert finder.find_device() == str(first)
    devices[:] = [Device(str(tmp_path / "ttyUSB9"), None), Device(str(second), "e661")]
    assert finder.find_device() == str(second)


def test_a_missing_device_is_named_with_the_devices_present(tmp_path):
    finder = DeviceFinder(parse_port("E661"), lambda: [Device("/dev/ttyUSB3", "A900")])
    with pytest.raises(LinkError, match=r"'E661'.*/dev/ttyUSB3 \(A900\)"):
        finder.find_device()
    with pytest.raises(LinkError, match="no serial port found"):
        DeviceFinder(parse_port(str(tmp_path / "nope")), list).find_device()


@pytest.mark.parametrize(
    ("data", "description"),
    [
        (b"3,M,46.9,M,,*47\r\n$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M", "--gnss"),
        (b"\r\nMicroPython v1.27.0 on 2026-01-01; Raspberry Pi Pico\r\n>>> ", "MicroPython prompt"),
        (b"Traceback (most recent call last):\r\n  File \"main.py\", line 1\r\n", "MicroPython prompt"),
        (b"ets Jul 29 2019 12:21:46\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13\r\n", "ESP32"),
        (b"\xb5\x62\x01\x07\x5c\x00" + bytes(92), "u-blox"),
        (b"temperature 21.5 humidity 40\n", "'temperature 21.5 humidity 40'"),
        (bytes(range(1, 256)), "baud rate"),
        (b"", "baud rate"),
    ],
)  # fmt: skip
def test_foreign_bytes_are_identified(data, description):
    assert description in describe_foreign_bytes(data, len(data))


def test_bytes_at_another_baud_rate_are_counted_and_both_rates_of_a_node_are_named():
    """921600 baud received at 115200: unstructured bytes for three seconds."""
    session = LinkSession("left", Discards())
    session.handle_up(LinkUp("left", 0, "/dev/ttyUSB0", False))
    for i in range(40):
        chunk = Chunk("left", i * 100_000_000, bytes((17 * i + k) % 255 + 1 for k in range(100)), "")
        assert list(session.route_frames(chunk)) == []
    (event,) = session.tick(4_000_000_000)
    line = event.text
    assert "4000 bytes, no frame; is the baud rate correct" in line
    assert "921600" in line and "115200" in line and "/dev/ttyUSB0" in line


def test_a_frame_cut_by_a_suspension_is_not_foreign_data():
    session = LinkSession("left", Discards())
    session.handle_up(LinkUp("left", 0, "/dev/left", False))
    list(session.route_frames(Chunk("left", NS_PER_S, b"\x05half", "")))
    assert list(session.tick(2 * NS_PER_S)) == []
    session.restart_timeouts(600 * NS_PER_S)
    assert list(session.tick(600 * NS_PER_S)) == []
    assert list(session.tick(604 * NS_PER_S)) != [], "bytes that are no frame for 3 s after it do"
