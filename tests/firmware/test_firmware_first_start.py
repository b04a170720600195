"""The first start of firmware and settings that came over the air: confirmed by a request, or undone."""

import json
import re

import pytest
from radio import switch

from hubodo.emulator.board.settings import Clock, Flash, Host
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.flash.image import build_image
from hubodo.flash.slots import MAIN, main_for_slot
from hubowire import FrameDecoder, decode
from hubowire.messages import GetHello, Hello
from slot_layouts import firmware, lay
from virtual_runs import request

LIMIT_S = 120.0
OLD = {"rate_hz": 52, "key": "00" * 32}
NEW = {"rate_hz": 13, "mag_rate_hz": 0, "filter_kind": 0}


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """Return an old and a new firmware, which differ in node.py alone."""
    folder = firmware(tmp_path_factory.mktemp("firmware") / "f", "A_OLD")
    old, node = build_image(folder, None), folder / "node.py"
    node.write_text(node.read_text().replace("A_OLD", "B_NEW"))
    return old, build_image(folder, None)


@pytest.fixture
def disk(images, tmp_path, monkeypatch):
    """Return a file system with the old firmware in A, and what an update has put into B, selected."""
    lay(images[0], tmp_path, "/fw_a")
    lay({name: content for name, content in images[1].items() if name != MAIN}, tmp_path, "/fw_b")
    (tmp_path / "main.py.new").write_bytes(main_for_slot(images[1][MAIN], "/fw_b"))
    (tmp_path / "config.json").write_text(json.dumps(OLD))
    (tmp_path / "fw_b" / "config.json").write_text(json.dumps(NEW))
    monkeypatch.setattr(switch, "_FILES_ROOT", f"{tmp_path}/")
    switch.switch(str(tmp_path / "fw_b"))
    return tmp_path


def starts(disk, seconds, *script):
    """Run a board with this file system; return the firmwares and rates of its starts."""
    node = VirtualNode(
        StillMotion(),
        Flash(folder=disk),
        clock=Clock("stepped", run_for=seconds),
        host=Host("memory", script=script),
        own_process=False,
    )
    with node:
        node.wait(60)
        output = node.output
    hellos = [decode(f.type_id, f.payload) for f in FrameDecoder().feed(output) if f.type_id == Hello.type_id]
    rates = dict.fromkeys((hello.boot_id, round(hello.rate_mhz / 1000)) for hello in hellos)
    return re.findall(rb"builds .*'._(NEW|OLD)'\]", output), [rate for _, rate in rates]


def is_as_before(disk, images):
    return (disk / MAIN).read_bytes() == main_for_slot(images[0][MAIN], "/fw_a") and json.loads(
        (disk / "config.json").read_text()
    ) == OLD


def test_a_request_of_the_host_confirms_firmware_and_settings(disk, images):
    assert starts(disk, 1.5, (1.0, request(1, GetHello()))) == ([b"NEW"], [12])
    assert (disk / MAIN).read_bytes() == main_for_slot(images[1][MAIN], "/fw_b")
    assert json.loads((disk / "config.json").read_text()) == OLD | NEW
    assert starts(disk, 0.8) == ([b"NEW"], [12])


def test_a_loss_of_power_before_a_request_brings_the_old_firmware_and_its_settings_back(disk, images):
    assert starts(disk, 1.0) == ([b"NEW"], [12])
    assert is_as_before(disk, images)


@pytest.mark.repeat
def test_without_a_request_the_node_restarts_with_the_old_firmware_after_two_minutes(disk, images):
    assert starts(disk, LIMIT_S + 3) == ([b"NEW", b"OLD"], [12, 52])
    assert is_as_before(disk, images)


@pytest.mark.parametrize(
    "damage",
    [
        lambda slot: (slot / "outbox.mpy").write_bytes(b"M\x05\x00\x1f"),
        lambda slot: (slot / "radio" / "trial.mpy").unlink(),
        lambda slot: (slot.parent / "config.json.new").write_text('{"pins": {"sda": 99}}'),
        lambda slot: (slot / "outbox.py").write_text("import time\nwhile True:\n    time.sleep_ms(50)\n"),
    ],
    ids=["incompatible", "no trial", "impossible pins", "hangs"],
)
def test_firmware_or_settings_that_fail_are_undone_by_a_restart(disk, images, damage):
    damage(disk / "fw_b")
    builds, rates = starts(disk, 10.0)
    assert builds[-1] == b"OLD" and rates == [52]
    assert is_as_before(disk, images)
