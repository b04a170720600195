"""Firmware over Wi-Fi and Bluetooth: through losses, doubled, late and forged packets, and through cuts."""

import json
import random
import shutil
import socket
import threading

import pytest
from test_flash_cut import apply, comes_up_as, flash

from fakes.fake_bluez import FakeBlueZ
from hubodo.cli import main
from hubodo.emulator.board.radio_medium import RadioMedium
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host
from hubodo.emulator.chips.ble_link import BleConditions
from hubodo.emulator.chips.ble_peripheral import BleAir, BlePeripheral
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.flash.image import build_image, firmware_folder
from hubodo.flash.slots import MAIN
from hubodo.ingest.link.keys import KeyRing
from slot_layouts import REPORT_MODULES, lay
from waiting import until

pytestmark = pytest.mark.real_time

SERIAL = "e661410300000001"
SEED = 5
CHANGED = ("node.py", "reports.py", "wifi.py")
"""Files that differ between old and new firmware; the others are copied on the node."""


class HostileNetwork:
    """Forwards datagrams between nodes and host; loses, doubles and delays some, and replays and forges."""

    def __init__(self, to, loss, seed):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.2)
        self.port = self.socket.getsockname()[1]
        self.is_cut = self.ended = False
        self.n_forwarded = self.n_lost = self.cut_at = 0
        self._to, self._loss, self._random = to, loss, random.Random(seed)
        self._routes, self._stored = {}, []
        self._threads = [threading.Thread(target=self._run, daemon=True)]
        self._threads[0].start()

    def _receive(self, endpoint):
        try:
            return endpoint.recvfrom(2048)
        except TimeoutError:
            return b"", None

    def _run(self):
        while not self.ended:
            data, node = self._receive(self.socket)
            if not data:
                continue
            if node not in self._routes:
                route = self._routes[node] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                route.settimeout(0.2)
                thread = threading.Thread(target=self._back, args=(route, node), daemon=True)
                self._threads.append(thread)
                thread.start()
            self._forward(data, self._routes[node], self._to)

    def _back(self, route, node):
        while not self.ended:
            data, _ = self._receive(route)
            if data:
                self._forward(data, self.socket, node)
                self._attack(data, node)

    def _forward(self, data, endpoint, to):
        self.n_forwarded += 1
        kind = self._random.random()
        if self.n_forwarded == self.cut_at:
            self.is_cut = True
        if self.is_cut or kind < self._loss:
            self.n_lost += 1
            return
        endpoint.sendto(data, to)
        if kind < 2 * self._loss:
            endpoint.sendto(data, to)
        elif kind < 3 * self._loss:
            timer = threading.Timer(0.3, lambda: self.ended or endpoint.sendto(data, to))
            timer.daemon = True
            timer.start()

    def _attack(self, data, node):
        """Replay a sealed packet of the host, send its frames without the seal, and a changed one."""
        if self._loss and data[:1] == b"\xff":
            self._stored.append(data)
            if len(self._stored) % 20 == 0:
                self.socket.sendto(self._stored[len(self._stored) // 2], node)
                self.socket.sendto(data[9:-8], node)
                self.socket.sendto(data[:12] + bytes([data[12] ^ 1]) + data[13:], node)

    def stop(self):
        self.ended = True
        for thread in self._threads:
            thread.join(5)
        for endpoint in (self.socket, *self._routes.values()):
            endpoint.close()


@pytest.fixture(scope="module")
def firmwares(tmp_path_factory):
    """Create an old and a new firmware; return the folder of the new one and the old files."""
    root = tmp_path_factory.mktemp("firmware")
    for name in ("old", "new"):
        shutil.copytree(firmware_folder(), root / name, ignore=shutil.ignore_patterns("__pycache__"))
        for changed in CHANGED:
            more = REPORT_MODULES if changed == "node.py" else ""
            path = root / name / changed
            path.write_text(f"{path.read_text()}\nBUILD = {name!r}\n{more}")
    return root / "new", build_image(root / "old", None)


class Bench:
    """A node with the old firmware in slot A, a hostile network, and the port and keys of a host."""

    def __init__(self, folder, image, loss=0.0, keyed=True):
        self.ring = KeyRing(folder / "keys.toml", create=True)
        key = self.ring.get_or_create_key(SERIAL).hex()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            number = free.getsockname()[1]
        self.port = f"udp://127.0.0.1:{number}"
        self.network = HostileNetwork(("127.0.0.1", number), loss, SEED)
        self.folder, self.journal = folder / "flash", folder / "journal"
        lay(image, self.folder, "/fw_a")
        self.config = {"link": "udp", "ssid": "net", "host": "127.0.0.1", "port": self.network.port}
        self.config |= {"rate_hz": 104, "key": key if keyed else ""}

    def node(self, **options):
        return VirtualNode(
            StillMotion(),
            Flash(None, self.config, folder=self.folder, journal=self.journal),
            # The interpreter in WebAssembly does not collect garbage.
            board=BoardSettings(model="pico_w", unique_id=SERIAL, heap_bytes=8 << 20),
            clock=Clock("paced"),
            **{"host": Host("udp")} | options,
        )

    def words(self):
        return ("--node", "left", "--key-file", str(self.ring.path))

    def comes_up_as(self, folder=None):
        """Return the firmware that a copy of the board runs after power-on, with a link by USB."""
        copy = self.folder.with_name("copy")
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(folder or self.folder, copy)
        (copy / "config.json").write_text("{}")
        return comes_up_as(copy)


@pytest.fixture
def bench(tmp_path, firmwares):
    benches = []

    def create(**options):
        benches.append(Bench(tmp_path, firmwares[1], **options))
        return benches[-1]

    yield create
    for each in benches:
        each.network.stop()


def test_a_node_is_flashed_through_losses_doubles_delays_replays_and_forgeries(
    firmwares, bench, tmp_path, monkeypatch, capfd
):
    """Until main.py is replaced the old firmware starts; the same settings and rollback as by cable."""
    here = bench(loss=0.04)
    before = tmp_path / "before"
    shutil.copytree(here.folder, before)
    with here.node():
        report = flash(here.port, firmwares[0], monkeypatch, capfd, *here.words(), "--set", "rate_hz=52")
        shutil.copytree(here.folder, tmp_path / "flashed")
        assert main(["flash", here.port, "--roll-back", *here.words()]) == 0
        capfd.readouterr()
    print(f"seed {SEED}: {here.network.n_lost} of {here.network.n_forwarded} datagrams lost, {report}")
    assert here.network.n_lost > 5 and report["repeated"] > 2
    expected = {name.replace(".py", ".mpy") for name in CHANGED} | {"files.json", "config.json", MAIN}
    assert set(report["copied"]) == expected
    assert here.comes_up_as(tmp_path / "flashed") == ["new"]
    assert here.comes_up_as() == ["old"]
    settings = json.loads((here.folder / "config.json").read_text())
    assert settings == here.config | {"rate_hz": 52}
    changes = [json.loads(line) for line in here.journal.read_text().splitlines()]
    switch = next(k for k, change in enumerate(changes) if change.get("to") == f"/{MAIN}")
    for k, change in enumerate(changes):
        apply(change, before)
        if k in (switch // 2, switch - 1):
            shutil.copytree(before, tmp_path / f"cut{k}")
            (tmp_path / f"cut{k}" / "config.json").write_text("{}")
            assert comes_up_as(tmp_path / f"cut{k}") == ["old"]


def test_after_a_cut_of_network_and_power_the_old_firmware_runs_and_the_update_continues(
    firmwares, bench, monkeypatch, capfd
):
    import hubodo.flash.over_air as over_air
    import hubodo.verbs.flash as verb

    here = bench()
    here.network.cut_at = 190
    monkeypatch.setattr(over_air, "_SILENCE_TIMEOUT_S", 2.0)
    monkeypatch.setattr(verb, "firmware_folder", lambda: firmwares[0])
    with here.node():
        assert main(["flash", here.port, *here.words()]) == 1
        error = capfd.readouterr().err
    assert "no answer for 2 s; the old firmware stays; flash again to continue" in error
    complete = [path.name for path in here.folder.glob("fw_b/**/*.mpy")]
    assert "commands.mpy" in complete, "the cut came after some files"
    assert here.comes_up_as() == ["old"]
    here.network.is_cut = False
    with here.node():
        report = flash(here.port, firmwares[0], monkeypatch, capfd, *here.words())
    assert "the list of files" not in report["copied"] and MAIN in report["copied"]
    assert here.comes_up_as() == ["new"]


def test_a_node_without_a_key_refuses_and_without_a_key_file_nothing_is_sent(
    firmwares, bench, monkeypatch, capfd
):
    here = bench(keyed=False)
    assert main(["flash", here.port]) == 2
    assert "--key-file" in capfd.readouterr().err
    before = sorted(here.folder.rglob("*"))
    with here.node() as node:
        until(lambda: node.stats["t"] > 1)
        assert main(["flash", here.port, *here.words()]) == 1
        assert "without a key); is the key file that of the node?" in capfd.readouterr().err
    assert sorted(p for p in here.folder.rglob("*") if p.name != "config.json") == before


@pytest.mark.repeat
def test_a_node_is_flashed_by_bluetooth(firmwares, bench, monkeypatch, capfd):
    here = bench()
    here.config["link"] = "ble"
    air = BleAir(BleConditions(interval=0.03, loss=0.02), seed=SEED)
    FakeBlueZ(air, monkeypatch)
    medium = RadioMedium(open_bluetooth=lambda mac, platform: BlePeripheral(air, mac, platform))
    with here.node(host=Host("memory"), own_process=False, radio_medium=medium):
        report = flash("ble://hubodo-1", firmwares[0], monkeypatch, capfd, *here.words())
    assert air.counts["exchanges lost"] > 5
    assert MAIN in report["copied"] and here.comes_up_as() == ["new"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            ("--set", "password=x"),
            "password: not over Wi-Fi or Bluetooth; packets are authenticated, not secret",
        ),
        (("--set", "node_id=2"), "use `hubodo node PORT set node_id=N`"),
        (("--roll-back", "--set", "rate_hz=52"), "--roll-back changes no settings"),
        (("--calibration", "c.toml"), "a calibration is written by USB"),
    ],
)
def test_what_cannot_go_over_the_air_is_refused_before_anything_is_sent(tmp_path, capfd, words, text):
    ring = KeyRing(tmp_path / "keys.toml", create=True)
    ring.get_or_create_key(SERIAL)
    assert main(["flash", "udp://127.0.0.1:1", "--key-file", str(ring.path), *words]) == 2
    assert text in capfd.readouterr().err
