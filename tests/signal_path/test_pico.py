"""The complete signal path on an emulated Pico: chips, MicroPython, USB, daemon, log; and `hubodo flash`."""

import json

import numpy as np
import pytest
from recorded import judge, recorder

from hubodo.cli import main
from hubodo.demo.simulated_drive import write_image
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.flash.image import build_image, firmware_folder
from hubodo.flash.slots import MAIN, SLOTS, main_for_slot
from hubodo.log.recording_reader import read_recording
from virtual_runs import pico_or_skip, unique_motion

# Seconds of real time per second of the board: 2 suffice on an idle core, not on a busy one.
PACE = 6
SECONDS = 1.8


@pytest.fixture(autouse=True)
def _needs_an_image():
    pico_or_skip()


@pytest.mark.real_time
@pytest.mark.repeat
def test_a_pico_slower_than_real_time_is_recorded_completely_with_a_slow_clock(tmp_path):
    """The sample intervals equal the node's, not six times as much.

    Delays of a busy computer are excepted: a board that had to wait catches up.
    """
    port, log = tmp_path / "ttyACM0", tmp_path / "pico.mcap"
    node = VirtualNode(
        unique_motion(30),
        Flash(write_image(tmp_path / "firmware", "rp2040"), {"rate_hz": 416}),
        board=BoardSettings(interpreter="rp2040"),
        clock=Clock("paced", pace=PACE),
        host=Host(path=port, wait=True),
    )
    with node:
        done = recorder(port, log, "--time-scale", str(PACE), "--duration", str(SECONDS)).communicate(
            timeout=300
        )
        truth = node.chip.truth()
    judge(done, log, truth, SECONDS)
    (table,) = read_recording(log).nodes.values()
    true_times = truth.t[: len(table)]
    assert 0.8 < np.polyfit(true_times, table.t, 1)[0] < 1.25


@pytest.mark.repeat
def test_an_empty_pico_gets_every_file_over_usb_and_runs_it(tmp_path, capfd):
    image = build_image(firmware_folder(), "armv6m")
    with VirtualNode(StillMotion(), board=BoardSettings(interpreter="rp2040"), clock=Clock("paced")) as board:
        code = main(["flash", board.port, "--node", "right", "--rate-hz", "416", "--json"])
        out, err = capfd.readouterr()
        assert code == 0, err
        assert set(json.loads(out)["copied"]) == {*image, "config.json", "files.json"}
        assert json.loads(out)["serial"] == "e6614103e7452d2f"
        slot = SLOTS[0]
        for name, content in image.items():
            held = content if name != MAIN else main_for_slot(content, slot)
            place = name if name == MAIN else f"{slot[1:]}/{name}"
            assert (board.flash / place).read_bytes() == held
        assert [why for _, why in board.stats["resets"]] == ["machine.reset"]
    assert json.loads(out)["node"] == 2
