"""`hubodo doctor` at a prompt, at a port without a node, and on the board: each fault is identified."""

import os
import re
import shutil
import threading

import pytest
import serial
from doctored import board, doctor, lay_flashed, wrongs

from hubodo.cli import main
from hubodo.emulator.board.settings import BoardSettings, SensorBoard


@pytest.fixture(scope="module")
def flashed(tmp_path_factory):
    return lay_flashed(tmp_path_factory.mktemp("flashed"))


def test_a_sound_board_is_ok_in_every_check_and_runs_on(flashed, tmp_path, capfd):
    with board(flashed, tmp_path, board=BoardSettings(model="pico_w")) as node:
        _, checks = doctor(capfd, node.port, "--repl")
        # The clock of a board delayed by a busy computer is late; test_reception_checks.py tests it.
        assert {row[0] for check, row in checks.items() if check != "clock"} == {"ok"}, list(checks.values())
        assert "Raspberry Pi Pico W" in checks["MicroPython"][1]
        assert "0x6B answers 0x69: LSM6DS33" in checks["wiring"][1] and "GPIO4" in checks["wiring"][1]
        assert re.search(r"41[5-7]\.\d Hz of 416 Hz, \d+ samples, 0 lost", checks["samples"][1])
        assert "gravity 9.8" in checks["standstill"][1]
        _, checks = doctor(capfd, node.port)
    assert checks["samples"][0] == "ok", "it runs on"
    assert [check for check, (verdict, _, _) in checks.items() if verdict == "unknown"] == [
        "MicroPython",
        "wiring",
        "files",
    ]
    assert "--repl" in checks["wiring"][1]


WIRES = {
    "good": ("ok", "both pulled up; 0x1E answers 0x3D: LIS3MDL, 0x6B answers 0x69: LSM6DS33", ""),
    "swapped": ("wrong", "SDA and SCL are exchanged: 0x1E, 0x6B answers", "SDA of the sensor board to GPIO4"),
    "no_pull_ups": ("wrong", "no pull-up on SDA (GPIO4) and SCL (GPIO5)", "4.7 kΩ"),
    "no_power": ("wrong", "both lines are held low", "no supply"),
    "sda_low": ("wrong", "SDA (GPIO4) is held low", "short to GND"),
    "scl_low": ("wrong", "SCL (GPIO5) is held low", "short to GND"),
}


@pytest.mark.parametrize("wiring", WIRES)
def test_a_board_at_its_prompt_shows_what_is_wrong_with_its_wires(tmp_path, capfd, wiring):
    with board(None, tmp_path, sensors=SensorBoard(wiring=wiring), own_process=False) as node:
        code, checks = doctor(capfd, node.port)
    verdict, row, remedy = WIRES[wiring]
    assert checks["wiring"][0] == verdict and row in checks["wiring"][1] and remedy in checks["wiring"][2]
    assert checks["protocol"][1] == "a MicroPython prompt" and checks["MicroPython"][0] == "ok"
    assert checks["files"][:2] == ("wrong", "no firmware on the board")
    assert checks["files"][2] == f"hubodo flash {node.port}" and code == 1
    assert {checks[check][0] for check in ("identification", "sensor", "samples")} == {"unknown"}


@pytest.mark.parametrize("model", ["esp32", "esp32_c3"])
def test_the_wires_of_this_board_are_checked(tmp_path, capfd, model):
    swapped, other = SensorBoard(wiring="swapped"), BoardSettings(model=model)
    with board(None, tmp_path, sensors=swapped, board=other, own_process=False) as node:
        _, checks = doctor(capfd, node.port)
    assert {"esp32": "SCL to GPIO22", "esp32_c3": "SCL to GPIO7"}[model] in checks["wiring"][2]


def test_files_that_differ_from_this_host_are_named(flashed, tmp_path, capfd):
    shutil.copytree(flashed, tmp_path / "flash")
    (tmp_path / "flash" / "fw_a" / "bias_initialiser.mpy").write_bytes(b"M\x06\x00\x1f" + bytes(20))
    with board(None, tmp_path, own_process=False) as node:
        code, checks = doctor(capfd, node.port)
    assert code == 1
    assert "1 of" in checks["files"][1] and "bias_initialiser.mpy" in checks["files"][1]


def test_a_busy_port_and_a_missing_one_are_identified(flashed, tmp_path, capfd):
    with board(flashed, tmp_path) as node, serial.Serial(str(node.port), exclusive=True):
        code, checks = doctor(capfd, node.port)
    assert code == 1 and wrongs(checks) == ["port"] and "busy" in " ".join(checks["port"])
    code, checks = doctor(capfd, tmp_path / "ttyNONE")
    assert code == 1 and wrongs(checks) == ["port"] and "no such device" in " ".join(checks["port"])
    assert checks["link"][1] == "first fix: port"


@pytest.mark.parametrize("noisy", [False, True])
def test_silence_and_bytes_without_a_frame_are_distinguished(capfd, noisy):
    master, slave = os.openpty()
    done = threading.Event()

    def babble():
        while noisy and not done.wait(0.05):
            os.write(master, bytes(range(128, 192)))

    thread = threading.Thread(target=babble)
    thread.start()
    try:
        code, checks = doctor(capfd, os.ttyname(slave))
    finally:
        done.set()
        thread.join()
        os.close(master)
        os.close(slave)
    assert code == 1 and wrongs(checks) == ["protocol"]
    assert ("no valid frame" if noisy else "no data") in checks["protocol"][1]
    assert ("baud" if noisy else "data cable") in checks["protocol"][2]


def test_too_short_a_listening_time_is_refused(tmp_path, capfd):
    assert main(["doctor", str(tmp_path / "tty"), "--seconds", "1"]) == 2
    assert "--seconds: 1: write a number from 3" in capfd.readouterr().err
