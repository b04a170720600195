"""`hubodo flash` through the pseudo terminal and the prompt of a virtual board."""

import json
import os
import termios

import pytest

import hubodo.flash.board
from hubodo.cli import main
from hubodo.emulator.board.settings import Flash
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.flash.image import build_image, firmware_folder
from hubodo.flash.manifest import MANIFEST
from hubodo.flash.slots import main_for_slot


@pytest.fixture(scope="module")
def board():
    """Yield a board with only MicroPython installed."""
    with VirtualNode(StillMotion(), seed=1) as node:
        yield node


@pytest.fixture(scope="module")
def image():
    return build_image(firmware_folder(), None)


def flash(capfd, *words):
    code = main(["flash", *map(str, words), "--json"])
    out, err = capfd.readouterr()
    return code, json.loads(out) if out else None, err


def test_an_empty_board_gets_every_file_and_runs_it(board, image, capfd):
    code, report, err = flash(capfd, board.port, "--node", "right", "--rate-hz", 416)
    assert code == 0, err
    assert report["node"] == 2
    assert set(report["copied"]) == {*image, MANIFEST, "config.json"}
    for name in set(image) - {"main.py"}:
        assert (board.flash / "fw_a" / name).read_bytes() == image[name]
    assert (board.flash / "main.py").read_bytes() == main_for_slot(image["main.py"], "/fw_a")
    assert {path.name for path in board.flash.iterdir()} == {"config.json", "fw_a", "main.py"}
    assert json.loads((board.flash / "config.json").read_text()) == {"node_id": 2, "rate_hz": 416}


def test_a_streaming_node_is_flashed_and_only_changed_files_are_copied(board, capfd):
    code, report, err = flash(capfd, board.port, "--node", "left")
    assert code == 0, err
    assert report["node"] == 1
    assert report["copied"] == ["config.json"]
    assert json.loads((board.flash / "config.json").read_text()) == {"node_id": 1, "rate_hz": 416}


def test_a_calibration_becomes_the_settings_of_its_node(board, tmp_path, capfd):
    """A calibration of another board, or without this node, is refused and changes nothing."""
    text = """
[nodes.left]
serial = "{serial}"
[nodes.left.effects.gyro_bias]
x = {{ value = 0.001, sigma = 1e-5 }}
[nodes.left.effects.gyro_warmup]
z = {{ value = -0.002, sigma = 1e-5 }}
time_constant = {{ value = 3600.0, sigma = 60.0 }}
"""
    path = tmp_path / "calibration.toml"
    before = (board.flash / "config.json").read_text()
    path.write_text(text.format(serial="0123456789abcdef"))
    code, _, err = flash(capfd, board.port, "--calibration", path)
    assert code == 2 and "0123456789abcdef" in err and err.count("\n") == 1
    path.write_text(text.format(serial="").replace("left", "right"))
    code, _, err = flash(capfd, board.port, "--calibration", path)
    assert code == 2 and "no node 'left', only right" in err
    assert (board.flash / "config.json").read_text() == before

    path.write_text(text.format(serial=""))
    code, report, err = flash(capfd, board.port, "--calibration", path)
    assert code == 0, err
    assert report["copied"] == ["config.json"]
    assert report["calibrated"] == {
        "bias_udps": [57296, 0, 0],
        "warmup_udps": [0, 0, -114592],
        "warmup_s": 3600,
    }
    path.write_text(text.format(serial=report["serial"]))
    code, again, err = flash(capfd, board.port, "--calibration", path)
    assert code == 0, err
    assert again["copied"] == [] and again["calibrated"] == report["calibrated"]
    assert json.loads((board.flash / "config.json").read_text()) == json.loads(before) | report["calibrated"]


def test_a_node_with_its_firmware_at_the_root_is_migrated(image, tmp_path, capfd):
    """Damaged files are sent again, valid ones copied on the node, sources that hide new ones deleted."""
    for name, content in {**image, "wire.mpy": b"damaged", "node.py": b"raise ValueError\n"}.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    (tmp_path / "notes.txt").write_text("mine")
    with VirtualNode(StillMotion(), Flash(folder=tmp_path), seed=2) as node:
        code, report, err = flash(capfd, node.port)
    assert code == 0, err
    assert report["copied"] == [MANIFEST, "main.py", "wire.mpy"]
    for name in set(image) - {"main.py"}:
        assert (tmp_path / "fw_a" / name).read_bytes() == image[name]
    assert {path.name for path in tmp_path.iterdir()} == {"fw_a", "main.py", "notes.txt"}


def test_a_port_read_by_another_program_is_reported_as_busy(board, capfd):
    import serial

    with serial.Serial(str(board.port), exclusive=True):
        code, _, err = flash(capfd, board.port)
    assert code == 1
    assert "busy" in err
    assert err.count("\n") == 1


def test_a_missing_port_is_refused_in_one_line(tmp_path, capfd):
    code, _, err = flash(capfd, tmp_path / "ttyNONE")
    assert code == 1
    assert "ttyNONE: no such device; plug it in" in err


@pytest.fixture
def silent_port(monkeypatch):
    """Yield (path, descriptor) of a terminal without a device, with a short timeout."""
    monkeypatch.setattr(hubodo.flash.board, "_REBOOT_TIMEOUT_S", 0.2)
    monkeypatch.setattr(hubodo.flash.board, "_PROMPT_RETURN_TIMEOUT_S", 0.5)
    master, slave = os.openpty()
    yield os.ttyname(slave), slave
    os.close(master)
    os.close(slave)


def test_a_silent_port_is_refused_in_one_line(silent_port, capfd):
    code, _, err = flash(capfd, silent_port[0])
    assert code == 1
    assert err.count("\n") == 1
    assert "no prompt; is MicroPython on the board?" in err


def test_the_port_is_opened_at_the_speed_of_a_console(silent_port, capfd):
    """The USB port of an ESP32 is a UART behind a converter: its output is readable at one speed only."""
    flash(capfd, silent_port[0])
    assert termios.tcgetattr(silent_port[1])[4:6] == [termios.B115200] * 2


def test_an_unknown_node_name_is_refused_before_the_port_is_touched(tmp_path, capfd):
    code, _, err = flash(capfd, tmp_path / "ttyNONE", "--node", "front")
    assert code == 2
    assert "--node front" in err
