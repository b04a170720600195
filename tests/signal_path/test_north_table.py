"""`hubodo north --live` end to end: the real firmware on a virtual board, a table on a pty, real time."""

import json
import math
import time

import numpy as np
import pytest

from fakes.fake_table import FakeTable
from fakes.turned_motion import TurnedMotion
from hubodo.cli import main
from hubodo.emulator.board.settings import Clock, Flash, Host
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.log.recording_reader import read_recording
from hubodo.sensors.north.motion_from_gyro import find_table_motion
from virtual_runs import FIRMWARE, micropython_or_skip

SPEED = 180.0
"""deg/s of the table."""


@pytest.fixture
def bench(tmp_path):
    """Yield a node on a port and a turntable under it with speed SPEED."""
    micropython_or_skip()
    motion = TurnedMotion(path=tmp_path / "motion")

    def turning(from_deg, to_deg, put):
        length = abs(to_deg - from_deg) / SPEED
        while math.isinf(motion.clock_zero):
            time.sleep(0.02)  # The board is powering on.
        start = time.monotonic()
        # Set slightly ahead, because the board creates its samples just before sending them.
        first = max(start - motion.clock_zero, motion.newest) + 0.2
        last = first + length
        motion.add_turn(first, last, math.radians(math.copysign(SPEED, to_deg - from_deg)))
        # The move does not end before the board, delayed by a busy computer, has measured all of it.
        while (share := (time.monotonic() - start) / (length + 0.4)) < 1.0 or motion.newest < last:
            put(from_deg + min(share, 1.0) * (to_deg - from_deg))
            time.sleep(0.02)

    port = tmp_path / "tty"
    node = VirtualNode(
        motion,
        Flash(FIRMWARE, {"rate_hz": 104}),
        clock=Clock("paced"),
        host=Host("pty", path=port),
    )
    with FakeTable(turning=turning) as table, node:
        yield port, table


def north(capsys, port, *words):
    common = ["--latitude-deg", "48", "--method", "maytag4", "--stop", "2", "--settle", "0.8", "--json"]
    status = main(["north", "--live", str(port), *common, *map(str, words)])
    out, err = capsys.readouterr()
    assert status == 0, err
    return json.loads(out), err


@pytest.mark.real_time
def test_a_real_node_is_turned_and_measures_the_turns_that_the_table_reports(bench, tmp_path, capsys):
    port, table = bench
    out = tmp_path / "north.mcap"
    north_result, _ = north(capsys, port, "--table", table.path, "--stops", 5, "-o", out)
    assert [angle % 360 for angle in table.visited] == [0, 180, 90, 270, 0]
    # A gyro with this noise cannot find north in five seconds, and the result must say so.
    assert north_result["sigma_deg"] > 45 and any(
        "does not determine north" in text for text in north_result["warnings"]
    )
    # The turns measured by the node equal those of the table: same clock, sign and scale.
    log = read_recording(out)
    (name,) = log.nodes
    node = log.nodes[name]
    motion = find_table_motion(node.t, node.gyro, np.array([0.0, 0.0, 1.0]), scale_sigma=0.01)
    stood = np.degrees(motion.angle[~motion.moving])
    assert stood[0] == 0.0 and np.round(stood[1:4] / 90).tolist() == [2, 1, 3]
