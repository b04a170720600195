"""`hubodo doctor` on running nodes names the fault of each, and nothing else."""

import re
import shutil

import pytest
from doctored import board, doctor, lay_flashed, wrongs

from hubodo.emulator.board.settings import BoardSettings, Clock, SensorBoard
from hubodo.emulator.chips.faults import BrownOut, BusNack, MissedSamples
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.motion import StillMotion
from virtual_runs import FIRMWARE, unique_motion


@pytest.fixture(scope="module")
def flashed(tmp_path_factory):
    return lay_flashed(tmp_path_factory.mktemp("flashed"))


NODES = {
    "missing chip": (
        {"faults": [BusNack(0.0, count=10**9)]},
        "sensor",
        "no IMU answers; only LIS3MDL at 0x1E on the bus",
    ),
    "nothing on the bus": (
        {"sensors": SensorBoard(wiring="no_pull_ups")},
        "sensor",
        "no IMU answers; nothing on the bus",
    ),
    "another chip": (
        {"sensors": SensorBoard(specimen=Specimen(who_am_i=0x6A))},
        "sensor",
        "0x6B answers 0x6A: LSM6DSL, LSM6DSM or LSM6DS3TR-C",
    ),
    "flat battery": ({"board": BoardSettings(battery_mv=3000)}, "power", "3.00 V: low"),
    "brown-out": (
        {"faults": [BrownOut(0.05)], "board": BoardSettings(model="pico_2")},
        "power",
        "last start: brown out",
    ),
    "lost samples": (
        {"faults": [MissedSamples(t, 9) for t in (1.5, 2.0, 2.5, 3.0)]},
        "samples",
        r"Hz of 416 Hz, \d+ samples, \d\d lost",
    ),
    "half of gravity": (
        {"motion": StillMotion(force=(0, 0, 4.9))},
        "standstill",
        r"gravity 4\.9",
    ),
    "gyro that turns at rest": (
        {"motion": StillMotion(rate=(0, 0, 0.9))},
        "standstill",
        r"\+51\.\d+ deg/s",
    ),
    "clock without a crystal": ({"clock": Clock("real", ppm=9000.0)}, "clock", r"\+\d{4,5} ± \d+ ppm"),
}


_LOOKS = 9
"""More looks at a board whose clock cannot wait: this computer may have had no time for it at the first."""


FIRST_OF_EACH_CHECK = {check: name for name, (_, check, _) in reversed(NODES.items())}.values()


@pytest.mark.parametrize(
    "case",
    [name if name in FIRST_OF_EACH_CHECK else pytest.param(name, marks=pytest.mark.repeat) for name in NODES],
)
def test_problems_of_a_running_node_are_named(flashed, tmp_path, capfd, case):
    settings, check, words = NODES[case]
    with board(flashed, tmp_path, **settings) as node:
        code, checks = doctor(capfd, node.port)
        for _ in range(_LOOKS if "clock" in settings else 0):
            if wrongs(checks)[:1] == [check]:
                break
            code, checks = doctor(capfd, node.port)
    assert code == 1 and wrongs(checks)[0] == check, list(checks.values())
    assert re.search(words, checks[check][1]), checks[check]
    assert checks[check][2], "and what to do"


def test_a_moving_node_is_not_checked_against_gravity(flashed, tmp_path, capfd):
    with board(flashed, tmp_path, motion=unique_motion(20)) as node:
        _, checks = doctor(capfd, node.port)
    assert checks["standstill"][:2] == ("unknown", "the board was moved"), list(checks.values())


def test_a_node_of_another_message_table_is_to_be_flashed(tmp_path, capfd):
    shutil.copytree(FIRMWARE, tmp_path / "flash")
    wire = tmp_path / "flash" / "wire.py"
    wire.write_text(
        re.sub(r"FINGERPRINT = const\(0x\w+\)", "FINGERPRINT = const(0x12345678)", wire.read_text())
    )
    with board(None, tmp_path) as node:
        code, checks = doctor(capfd, node.port)
    assert code == 1 and wrongs(checks) == ["identification"]
    assert "speaks 12345678" in checks["identification"][1] and "hubodo flash" in checks["identification"][2]
