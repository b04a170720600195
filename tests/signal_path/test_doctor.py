"""`hubodo doctor` on emulated boards: each thing that can be wrong with a first board has its own words."""

import contextlib
import json
import os
import re
import shutil
import threading
import time

import pytest
import serial

from hubodo.cli import main
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, SensorBoard
from hubodo.emulator.chips.faults import BrownOut, BusNack, MissedSamples
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.flash.check_result import CHECKS
from hubodo.flash.image import build, firmware_folder
from hubodo.flash.slots import MAIN, main_for
from virtual_runs import FIRMWARE, micropython_or_skip, unique_motion


def doctor(capfd, port, *words):
    """Exit code, (verdict, seen, remedy) by check."""
    micropython_or_skip()
    code = main(["doctor", str(port), "--json", "--seconds", "3", *words])
    out, err = capfd.readouterr()
    assert out, err
    result = json.loads(out.splitlines()[-1])
    assert [row["check"] for row in result["checks"]] == list(CHECKS)
    assert result["ok"] == (code == 0)
    return code, {row["check"]: (row["verdict"], row["seen"], row["remedy"]) for row in result["checks"]}


def wrongs(found):
    return [check for check, (verdict, _, _) in found.items() if verdict == "wrong"]


@pytest.fixture(scope="module")
def flashed(tmp_path_factory):
    """A file system as `hubodo flash` leaves it."""
    root = tmp_path_factory.mktemp("flashed")
    for name, content in build(firmware_folder(), None).items():
        path = root / ("" if name == MAIN else "fw_a") / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(main_for(content, "/fw_a") if name == MAIN else content)
    return root


@contextlib.contextmanager
def board(flashed, tmp_path, **settings):
    """A virtual board; a paced clock is late at first, for as long as the interpreter took to load."""
    if flashed is not None:
        shutil.copytree(flashed, tmp_path / "flash", dirs_exist_ok=True)
    settings = {"motion": StillMotion(), "clock": Clock("paced"), **settings}
    with VirtualNode(settings.pop("motion"), Flash(folder=tmp_path / "flash"), **settings) as node:
        time.sleep(1.5)
        yield node


def test_a_sound_board_is_ok_in_every_check_and_runs_on(flashed, tmp_path, capfd):
    with board(flashed, tmp_path, board=BoardSettings(model="pico_w")) as node:
        code, found = doctor(capfd, node.port, "--repl")
        assert {verdict for verdict, _, _ in found.values()} == {"ok"} and code == 0, list(found.values())
        assert "Raspberry Pi Pico W" in found["MicroPython"][1]
        assert "0x6B answers 0x69: LSM6DS33" in found["wires"][1] and "GPIO4" in found["wires"][1]
        assert re.search(r"41[5-7]\.\d Hz of 416 Hz, \d+ samples, 0 lost", found["samples"][1])
        assert "gravity 9.8" in found["rest"][1]
        code, found = doctor(capfd, node.port)
    assert code == 0, "it runs on"
    assert [check for check, (verdict, _, _) in found.items() if verdict == "unknown"] == [
        "MicroPython",
        "wires",
        "files",
    ]
    assert "--repl" in found["wires"][1]


WIRES = {
    "good": ("ok", "both pulled up; 0x1E answers 0x3D: LIS3MDL, 0x6B answers 0x69: LSM6DS33", ""),
    "swapped": ("wrong", "SDA and SCL are exchanged: 0x1E, 0x6B answers", "SDA goes to GPIO4"),
    "no_pull_ups": ("wrong", "nothing pulls up SDA (GPIO4) and SCL (GPIO5)", "4.7 kΩ"),
    "no_power": ("wrong", "both lines are held low", "no supply"),
    "sda_low": ("wrong", "SDA (GPIO4) is held low", "short to GND"),
    "scl_low": ("wrong", "SCL (GPIO5) is held low", "short to GND"),
}


@pytest.mark.parametrize("wiring", WIRES)
def test_a_board_at_its_prompt_shows_what_is_wrong_with_its_wires(tmp_path, capfd, wiring):
    with board(None, tmp_path, sensors=SensorBoard(wiring=wiring)) as node:
        code, found = doctor(capfd, node.port)
    verdict, seen, remedy = WIRES[wiring]
    assert found["wires"][0] == verdict and seen in found["wires"][1] and remedy in found["wires"][2]
    assert found["speech"][1] == "a MicroPython prompt" and found["MicroPython"][0] == "ok"
    assert found["files"][:2] == ("wrong", "no firmware on the board")
    assert found["files"][2] == f"hubodo flash {node.port}" and code == 1
    assert {found[check][0] for check in ("hello", "sensor", "samples")} == {"unknown"}


@pytest.mark.parametrize("model", ["esp32", "esp32_c3"])
def test_the_wires_are_looked_at_where_this_board_has_them(tmp_path, capfd, model):
    with board(
        None, tmp_path, sensors=SensorBoard(wiring="swapped"), board=BoardSettings(model=model)
    ) as node:
        _, found = doctor(capfd, node.port)
    assert {"esp32": "its SCL to GPIO22", "esp32_c3": "its SCL to GPIO7"}[model] in found["wires"][2]


NODES = {
    "missing chip": (
        {"faults": [BusNack(0.0, count=10**9)]},
        "sensor",
        "no IMU answers; only LIS3MDL at 0x1E is on the bus",
    ),
    "nothing on the bus": (
        {"sensors": SensorBoard(wiring="no_pull_ups")},
        "sensor",
        "no IMU answers; nothing is on the bus",
    ),
    "another chip": (
        {"sensors": SensorBoard(specimen=Specimen(who_am_i=0x6C))},
        "sensor",
        "0x6B answers 0x6C: LSM6DSO or LSM6DSOX",
    ),
    "flat battery": ({"board": BoardSettings(battery_mv=3000)}, "power", "3.00 V: low"),
    "brown-out": (
        {"faults": [BrownOut(0.2)], "board": BoardSettings(model="pico_2")},
        "power",
        "last start: brown out",
    ),
    "lost samples": (
        {"faults": [MissedSamples(t, 9) for t in (2.5, 3.0, 3.5, 4.0)]},
        "samples",
        r"Hz of 416 Hz, \d+ samples, \d\d lost",
    ),
    "half of gravity": ({"motion": StillMotion(force=(0, 0, 4.9))}, "rest", r"gravity 4\.9"),
    "gyro that turns at rest": ({"motion": StillMotion(rate=(0, 0, 0.9))}, "rest", r"\+51\.\d+ deg/s"),
    "clock without a crystal": ({"clock": Clock("paced", ppm=9000.0)}, "clock", r"\+\d{4,5} ± \d+ ppm"),
}


@pytest.mark.parametrize("case", NODES)
def test_what_is_wrong_with_a_node_that_runs_is_named(flashed, tmp_path, capfd, case):
    settings, check, words = NODES[case]
    with board(flashed, tmp_path, **settings) as node:
        code, found = doctor(capfd, node.port)
    assert code == 1 and wrongs(found)[0] == check, list(found.values())
    assert re.search(words, found[check][1]), found[check]
    assert found[check][2], "and what to do"


def test_a_node_that_is_moved_is_not_judged_by_gravity(flashed, tmp_path, capfd):
    with board(flashed, tmp_path, motion=unique_motion(20)) as node:
        code, found = doctor(capfd, node.port)
    assert found["rest"][:2] == ("unknown", "it was moved") and code == 0, list(found.values())


def test_a_node_of_another_message_table_is_told_to_be_flashed(tmp_path, capfd):
    shutil.copytree(FIRMWARE, tmp_path / "flash")
    wire = tmp_path / "flash" / "wire.py"
    wire.write_text(
        re.sub(r"FINGERPRINT = const\(0x\w+\)", "FINGERPRINT = const(0x12345678)", wire.read_text())
    )
    with board(None, tmp_path) as node:
        code, found = doctor(capfd, node.port)
    assert code == 1 and wrongs(found) == ["hello"]
    assert "speaks 12345678" in found["hello"][1] and "hubodo flash" in found["hello"][2]


def test_files_that_differ_from_this_host_are_named(flashed, tmp_path, capfd):
    shutil.copytree(flashed, tmp_path / "flash")
    (tmp_path / "flash" / "fw_a" / "static_init.mpy").write_bytes(b"M\x06\x00\x1f" + bytes(20))
    with board(None, tmp_path, sensors=SensorBoard(wiring="good")) as node:
        code, found = doctor(capfd, node.port)
    assert code == 1
    assert "1 of" in found["files"][1] and "static_init.mpy" in found["files"][1]


def test_a_busy_port_and_a_missing_one_are_said_to_be_that(flashed, tmp_path, capfd):
    with board(flashed, tmp_path) as node, serial.Serial(str(node.port), exclusive=True):
        code, found = doctor(capfd, node.port)
    assert code == 1 and wrongs(found) == ["port"] and "busy" in " ".join(found["port"])
    code, found = doctor(capfd, tmp_path / "ttyNONE")
    assert code == 1 and wrongs(found) == ["port"] and "no such device" in " ".join(found["port"])
    assert found["link"][1] == "first put right what is wrong with: port"


@pytest.mark.parametrize("noisy", [False, True])
def test_silence_and_bytes_without_a_frame_are_told_apart(capfd, noisy):
    master, slave = os.openpty()
    done = threading.Event()

    def babble():
        while noisy and not done.wait(0.05):
            os.write(master, bytes(range(128, 192)))

    thread = threading.Thread(target=babble)
    thread.start()
    try:
        code, found = doctor(capfd, os.ttyname(slave))
    finally:
        done.set()
        thread.join()
        os.close(master)
        os.close(slave)
    assert code == 1 and wrongs(found) == ["speech"]
    assert ("not one frame" if noisy else "silence") in found["speech"][1]
    assert ("baud" if noisy else "data cable") in found["speech"][2]


def test_too_short_a_look_is_refused(tmp_path, capfd):
    assert main(["doctor", str(tmp_path / "tty"), "--seconds", "1"]) == 2
    assert "--seconds 1" in capfd.readouterr().err
