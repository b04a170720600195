"""`hubodo doctor` without a port: findings about the computer, with remedies."""

import json
import os
import re
import subprocess
from dataclasses import dataclass, field

import pytest
import serial

from fakes.fake_node import FakeNode
from hubodo.errors import LinkError
from hubodo.flash import computer_checks
from hubodo.flash.computer import HostComputer
from hubodo.flash.computer_checks import check_computer
from hubodo.flash.reception import Reception
from hubodo.verbs import doctor as verb
from in_process import hubodo

PICO_USB_ID, CONVERTER_USB_ID = (0x2E8A, 0x0005), (0x10C4, 0xEA60)


@dataclass
class Port:
    """A serial port as listed by pyserial."""

    device: str
    vid: int | None = PICO_USB_ID[0]
    pid: int | None = PICO_USB_ID[1]
    description: str = "Board in FS mode"
    serial_number: str | None = "E6611"


@dataclass(frozen=True)
class FakeComputer(HostComputer):
    """A computer without problems, except for those that a test sets."""

    linux: bool = True
    group_membership: tuple = ("dialout", True, True)
    forbidden: tuple = ()
    clock_synchronised: bool | None = True
    free: int = 50_000_000_000
    missing: dict = field(default_factory=dict)
    packages: tuple = ()

    def has_package(self, name):
        return name in self.packages

    def serial_group(self, device):
        return self.group_membership

    def is_accessible(self, path):
        return path not in self.forbidden

    def is_clock_synchronised(self):
        return self.clock_synchronised

    def free_disk_bytes(self):
        if self.free < 0:
            raise FileNotFoundError(2, "No such file or directory")
        return self.free

    def missing_packages(self):
        return self.missing


def findings_of(tmp_path, *ports, listen=lambda port: Reception(has_prompt=True), **facts):
    """Check a fake computer and return its findings by check."""
    computer = FakeComputer(folder=tmp_path, root=tmp_path, ports=lambda: ports, **facts)
    findings = {}
    for finding in check_computer(computer, listen):
        findings.setdefault(finding.check, []).append(finding)
    return findings


def add_process(root, pid, name, *files):
    folder = root / "proc" / str(pid)
    (folder / "fd").mkdir(parents=True)
    (folder / "comm").write_text(f"{name}\n")
    for number, file in enumerate(files):
        (folder / "fd" / str(number)).symlink_to(file)


def test_without_a_board_the_remedy_is_to_plug_one_in(tmp_path):
    findings = findings_of(tmp_path, Port("/dev/ttyS0", None, None))
    assert {check for check, (finding, *_) in findings.items() if finding.verdict != "ok"} == {"ports"}
    (ports,) = findings["ports"]
    assert ports.verdict == "warn" and "1 serial ports that are not on USB" in ports.observation
    assert "data cable" in ports.remedy


def test_the_process_that_holds_a_port_is_named_and_the_port_is_not_opened(tmp_path):
    device = tmp_path / "ttyACM0"
    device.touch()
    add_process(tmp_path, 4242, "screen", "/dev/null", device)
    add_process(tmp_path, 17, "bash", "/dev/null")
    findings = findings_of(
        tmp_path, Port(str(device)), listen=lambda port: pytest.fail("the port was opened")
    )
    (port,) = findings["ports"]
    assert port.verdict == "warn" and "open in screen (process 4242)" in port.observation
    assert "2e8a:0005" in port.observation and "E6611" in port.observation and "stop screen" in port.remedy


def test_a_file_closed_during_the_search_does_not_hide_the_holder_of_a_port(tmp_path):
    device = tmp_path / "ttyACM0"
    device.touch()
    add_process(tmp_path, 4242, "screen", "/dev/null", device, "/dev/null")
    descriptors = tmp_path / "proc" / "4242" / "fd"
    for closed in ("0", "2"):  # listed, but no longer a link: readlink fails
        (descriptors / closed).unlink()
        (descriptors / closed).touch()
    (holder,) = HostComputer(root=tmp_path).port_holders(str(device))
    assert (holder.pid, holder.command) == (4242, "screen")


def test_the_holder_of_a_real_port_is_found():
    """A real port is held by another real process."""
    master, slave = os.openpty()
    try:
        with serial.Serial(os.ttyname(slave), exclusive=True):
            assert HostComputer().port_holders(os.ttyname(slave)) == [], "the own process is not reported"
            holder_process = subprocess.Popen(["cat"], stdin=subprocess.PIPE, pass_fds=[slave])
            try:
                (holder,) = HostComputer().port_holders(os.ttyname(slave))
                assert (holder.pid, holder.command) == (holder_process.pid, "cat")
            finally:
                holder_process.communicate()
    finally:
        os.close(master)
        os.close(slave)


@pytest.mark.parametrize(
    ("group_membership", "forbidden", "verdict", "remedy"),
    [
        (("dialout", False, False), True, "bad", "sudo usermod -aG dialout $USER"),
        (("dialout", True, False), True, "bad", "log out and in again"),
        (("uucp", False, False), False, "warn", "sudo usermod -aG uucp $USER"),
        (("dialout", True, True), False, "ok", ""),
    ],
)
def test_permissions_are_checked_for_the_existing_ports(
    tmp_path, group_membership, forbidden, verdict, remedy
):
    port = Port(str(tmp_path / "ttyACM0"))
    ports = [port] if forbidden else []
    findings = findings_of(tmp_path, *ports, group_membership=group_membership, forbidden=(port.device,))
    (rights,) = findings["rights"]
    assert rights.verdict == verdict and remedy in rights.remedy
    assert not any(check.startswith("board on") for check in findings)


def test_modem_manager_is_a_warning_until_a_udev_rule_excludes_the_ports(tmp_path):
    add_process(tmp_path, 99, "ModemManager")
    add_process(tmp_path, 100, "brltty")
    findings = findings_of(tmp_path)
    assert (findings["ModemManager"][0].verdict, findings["brltty"][0].verdict) == ("warn", "warn")
    rule = findings["ModemManager"][0].remedy.split("'")[1]
    rules = tmp_path / "etc/udev/rules.d"
    rules.mkdir(parents=True)
    (rules / "70-hubodo.rules").write_text(rule)
    assert findings_of(tmp_path)["ModemManager"][0].verdict == "ok"


def test_clock_disk_and_packages_have_findings_with_remedies(tmp_path, monkeypatch):
    assert findings_of(tmp_path, clock_synchronised=False)["clock"][0].verdict == "warn"
    assert findings_of(tmp_path, clock_synchronised=None)["clock"][0].verdict == "ok"
    disks = {
        free: findings_of(tmp_path, free=free)["disk"][0].verdict
        for free in (100_000_000, 3_000_000_000, 9_000_000_000)
    }
    assert list(disks.values()) == ["bad", "warn", "ok"]
    assert findings_of(tmp_path, free=-1)["disk"][0].verdict == "bad"
    assert "not writable" in findings_of(tmp_path, forbidden=(str(tmp_path),))["disk"][0].observation
    (packages,) = findings_of(tmp_path, missing={"hubodo flash": "mpremote missing → pip install x"})[
        "packages"
    ]
    assert packages.observation == "for hubodo flash: mpremote missing" and packages.remedy == "pip install x"
    monkeypatch.setattr(computer_checks.time, "time", lambda: 1000.0)
    assert findings_of(tmp_path)["clock"][0].verdict == "bad", "the clock shows 1970"


def listen_to_busy_port(port):
    raise LinkError(f"{port}: busy: another program has it; close that program")


@pytest.mark.parametrize(
    ("listen", "verdict", "observation", "remedy"),
    [
        (
            lambda port: Reception(has_prompt=True),
            "warn",
            "without a running node",
            "hubodo flash /dev/ttyACM0",
        ),
        (
            lambda port: Reception(n_bytes=70),
            "warn",
            "70 bytes, but no valid frame",
            "hubodo doctor /dev/ttyACM0",
        ),
        (lambda port: Reception(), "warn", "silent", "hubodo doctor /dev/ttyACM0"),
        (lambda port: Reception(mismatch="speaks 1: ..."), "bad", "speaks 1", "hubodo flash /dev/ttyACM0"),
        (listen_to_busy_port, "bad", "busy: another program has it", "close that program"),
    ],
)
def test_a_board_without_a_running_node_has_a_finding_with_a_remedy(
    tmp_path, listen, verdict, observation, remedy
):
    (board,) = findings_of(tmp_path, Port("/dev/ttyACM0"), listen=listen)["board on /dev/ttyACM0"]
    assert board.verdict == verdict and observation in board.observation and board.remedy == remedy


def test_a_device_behind_a_usb_converter_is_not_opened(tmp_path):
    findings = findings_of(
        tmp_path,
        Port("/dev/ttyUSB0", *CONVERTER_USB_ID),
        listen=lambda port: pytest.fail("the port was opened"),
    )
    assert findings["ports"][0].verdict == "ok"


@pytest.mark.real_time
def test_running_nodes_are_found_with_their_firmware_and_problems_give_exit_code_1(tmp_path, monkeypatch):
    with FakeNode(node_id=1) as left, FakeNode(node_id=2) as right:
        ports = [Port(left.path), Port(right.path)]
        for free, code in ((50_000_000_000, 0), (1000, 1)):
            computer = FakeComputer(folder=tmp_path, root=tmp_path, ports=lambda: ports, free=free)
            monkeypatch.setattr(verb, "HostComputer", lambda computer=computer: computer)
            monkeypatch.setattr(computer_checks, "_LISTENING_S", 1.5)
            done = hubodo("doctor", *(["--json"] if not code else []))
            assert done.code == code, done
            if not code:
                checks = {check["check"]: check for check in json.loads(done.out)["checks"]}
                assert "node 'left', firmware" in checks[f"board on {left.path}"]["seen"]
                assert "node 'right', firmware" in checks[f"board on {right.path}"]["seen"]
            else:
                assert re.search("bad +disk", done.out) and "→ free disk space" in done.out


def bluetooth_of(tmp_path, **facts):
    """Return the verdict and text of the finding about Bluetooth; None without one."""
    rows = findings_of(tmp_path, **facts).get("Bluetooth")
    return None if rows is None else (rows[0].verdict, f"{rows[0].observation} {rows[0].remedy}")


def test_bluetooth_is_checked_from_the_package_to_the_adapter_the_service_and_the_rights(tmp_path):
    assert bluetooth_of(tmp_path) is None, "nobody asked for it"
    verdict, text = bluetooth_of(tmp_path, packages=("bleak",))
    assert verdict == "warn" and "no adapter" in text
    switch = tmp_path / "sys/class/bluetooth/hci0/rfkill1/soft"
    switch.parent.mkdir(parents=True)
    (tmp_path / "sys/class/bluetooth/hci0:64").mkdir()
    switch.write_text("1\n")
    verdict, text = bluetooth_of(tmp_path)
    assert verdict == "ok" and "hci0; " in text and "hubodo[ble]" in text
    verdict, text = bluetooth_of(tmp_path, packages=("bleak",))
    assert verdict == "warn" and "rfkill unblock" in text
    switch.write_text("0\n")
    verdict, text = bluetooth_of(tmp_path, packages=("bleak",))
    assert verdict == "warn" and "bluetoothd" in text
    add_process(tmp_path, 311, "bluetoothd")
    bus = str(tmp_path / "run/dbus/system_bus_socket")
    verdict, text = bluetooth_of(tmp_path, packages=("bleak",), forbidden=(bus,))
    assert verdict == "warn" and "usermod -aG bluetooth" in text
    assert bluetooth_of(tmp_path, packages=("bleak",)) == ("ok", "hci0, BlueZ is running ")
