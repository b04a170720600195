"""`hubodo doctor` without a port: what it says of a computer, and what to do."""

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

PICO, CONVERTER = (0x2E8A, 0x0005), (0x10C4, 0xEA60)


@dataclass
class Port:
    """As pyserial lists one."""

    device: str
    vid: int | None = PICO[0]
    pid: int | None = PICO[1]
    description: str = "Board in FS mode"
    serial_number: str | None = "E6611"


@dataclass(frozen=True)
class FakeComputer(HostComputer):
    """One on which everything is as it should be, but for what a test says."""

    linux: bool = True
    member: tuple = ("dialout", True, True)
    forbidden: tuple = ()
    kept: bool | None = True
    free: int = 50_000_000_000
    lacking: dict = field(default_factory=dict)

    def serial_group(self, device):
        return self.member

    def is_accessible(self, path):
        return path not in self.forbidden

    def is_clock_synchronised(self):
        return self.kept

    def free_disk_bytes(self):
        if self.free < 0:
            raise FileNotFoundError(2, "No such file or directory")
        return self.free

    def missing_packages(self):
        return self.lacking


def looked(tmp_path, *ports, hear=lambda port: Reception(prompt=True), **facts):
    """{check: [finding]} and all findings."""
    computer = FakeComputer(folder=tmp_path, root=tmp_path, ports=lambda: ports, **facts)
    found = {}
    for finding in check_computer(computer, hear):
        found.setdefault(finding.check, []).append(finding)
    return found


def process(root, pid, name, *files):
    folder = root / "proc" / str(pid)
    (folder / "fd").mkdir(parents=True)
    (folder / "comm").write_text(f"{name}\n")
    for number, file in enumerate(files):
        (folder / "fd" / str(number)).symlink_to(file)


def test_a_sound_computer_without_a_board_is_told_to_plug_one_in(tmp_path):
    found = looked(tmp_path, Port("/dev/ttyS0", None, None))
    assert {check for check, (finding, *_) in found.items() if finding.verdict != "ok"} == {"ports"}
    (ports,) = found["ports"]
    assert ports.verdict == "warn" and "1 serial ports that are not on USB" in ports.observation
    assert "data cable" in ports.remedy


def test_who_has_a_port_is_named_and_a_held_port_is_not_listened_to(tmp_path):
    device = tmp_path / "ttyACM0"
    device.touch()
    process(tmp_path, 4242, "screen", "/dev/null", device)
    process(tmp_path, 17, "bash", "/dev/null")
    found = looked(tmp_path, Port(str(device)), hear=lambda port: pytest.fail("it was listened to"))
    (port,) = found["ports"]
    assert port.verdict == "warn" and "open in screen (process 4242)" in port.observation
    assert "2e8a:0005" in port.observation and "E6611" in port.observation and "stop screen" in port.remedy


def test_a_file_that_is_closed_while_we_look_hides_no_holder(tmp_path):
    device = tmp_path / "ttyACM0"
    device.touch()
    process(tmp_path, 4242, "screen", "/dev/null", device, "/dev/null")
    descriptors = tmp_path / "proc" / "4242" / "fd"
    for gone in ("0", "2"):  # listed, but no link any more: readlink refuses
        (descriptors / gone).unlink()
        (descriptors / gone).touch()
    (holder,) = HostComputer(root=tmp_path).port_holders(str(device))
    assert (holder.pid, holder.command) == (4242, "screen")


def test_who_has_a_port_is_seen_on_this_computer_too():
    """A real port, held by a real process other than this one."""
    master, slave = os.openpty()
    try:
        with serial.Serial(os.ttyname(slave), exclusive=True):
            assert HostComputer().port_holders(os.ttyname(slave)) == [], "not by ourselves"
            waits = subprocess.Popen(["cat"], stdin=subprocess.PIPE, pass_fds=[slave])
            try:
                (holder,) = HostComputer().port_holders(os.ttyname(slave))
                assert (holder.pid, holder.command) == (waits.pid, "cat")
            finally:
                waits.communicate()
    finally:
        os.close(master)
        os.close(slave)


@pytest.mark.parametrize(
    ("member", "forbidden", "verdict", "remedy"),
    [
        (("dialout", False, False), True, "bad", "sudo usermod -aG dialout $USER"),
        (("dialout", True, False), True, "bad", "log out and in again"),
        (("uucp", False, False), False, "warn", "sudo usermod -aG uucp $USER"),
        (("dialout", True, True), False, "ok", ""),
    ],
)
def test_rights_are_judged_by_the_ports_that_are_there(tmp_path, member, forbidden, verdict, remedy):
    port = Port(str(tmp_path / "ttyACM0"))
    ports = [port] if forbidden else []
    found = looked(tmp_path, *ports, member=member, forbidden=(port.device,))
    (rights,) = found["rights"]
    assert rights.verdict == verdict and remedy in rights.remedy
    assert not any(check.startswith("board on") for check in found)


def test_modem_manager_is_a_warning_until_udev_tells_it_to_keep_away(tmp_path):
    process(tmp_path, 99, "ModemManager")
    process(tmp_path, 100, "brltty")
    found = looked(tmp_path)
    assert (found["ModemManager"][0].verdict, found["brltty"][0].verdict) == ("warn", "warn")
    rule = found["ModemManager"][0].remedy.split("'")[1]
    rules = tmp_path / "etc/udev/rules.d"
    rules.mkdir(parents=True)
    (rules / "70-hubodo.rules").write_text(rule)
    assert looked(tmp_path)["ModemManager"][0].verdict == "ok"


def test_clock_disk_and_packages_are_told_with_what_to_do(tmp_path, monkeypatch):
    assert looked(tmp_path, kept=False)["clock"][0].verdict == "warn"
    assert looked(tmp_path, kept=None)["clock"][0].verdict == "ok"
    disks = {
        free: looked(tmp_path, free=free)["disk"][0].verdict
        for free in (100_000_000, 3_000_000_000, 9_000_000_000)
    }
    assert list(disks.values()) == ["bad", "warn", "ok"]
    assert looked(tmp_path, free=-1)["disk"][0].verdict == "bad"
    assert "not writable" in looked(tmp_path, forbidden=(str(tmp_path),))["disk"][0].observation
    (packages,) = looked(tmp_path, lacking={"hubodo flash": "mpremote missing → pip install x"})["packages"]
    assert packages.observation == "for hubodo flash: mpremote missing" and packages.remedy == "pip install x"
    monkeypatch.setattr(computer_checks.time, "time", lambda: 1000.0)
    assert looked(tmp_path)["clock"][0].verdict == "bad", "1970"


def refuse(port):
    raise LinkError(f"{port}: busy: another program has it; close that program")


@pytest.mark.parametrize(
    ("hear", "verdict", "seen", "remedy"),
    [
        (lambda port: Reception(prompt=True), "warn", "without a running node", "hubodo flash /dev/ttyACM0"),
        (
            lambda port: Reception(n_bytes=70),
            "warn",
            "70 bytes, but no valid frame",
            "hubodo doctor /dev/ttyACM0",
        ),
        (lambda port: Reception(), "warn", "silent", "hubodo doctor /dev/ttyACM0"),
        (lambda port: Reception(mismatch="speaks 1: ..."), "bad", "speaks 1", "hubodo flash /dev/ttyACM0"),
        (refuse, "bad", "busy: another program has it", "close that program"),
    ],
)
def test_a_board_that_is_no_node_is_told_with_what_to_do(tmp_path, hear, verdict, seen, remedy):
    (board,) = looked(tmp_path, Port("/dev/ttyACM0"), hear=hear)["board on /dev/ttyACM0"]
    assert board.verdict == verdict and seen in board.observation and board.remedy == remedy


def test_what_hangs_behind_a_converter_is_asked_nothing(tmp_path):
    found = looked(tmp_path, Port("/dev/ttyUSB0", *CONVERTER), hear=lambda port: pytest.fail("it was"))
    assert found["ports"][0].verdict == "ok"


@pytest.mark.real_time
def test_nodes_are_found_with_their_firmware_and_bad_findings_give_exit_code_1(tmp_path, monkeypatch):
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
