"""`hubodo north --live` end to end: the real firmware on a virtual board, a table on a pty, real time."""

import json
import math
import time
from dataclasses import dataclass, field
from importlib import import_module

import numpy as np
import pytest

from fakes.fake_table import FakeTable
from hubodo.cli import main
from hubodo.earth import STANDARD_GRAVITY
from hubodo.emulator.board.settings import Clock, Flash, Host
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.log.recording_reader import read_recording
from hubodo.sensors.north.motion_from_gyro import find_table_motion
from virtual_runs import FIRMWARE, micropython_or_skip

SPEED = 180.0
"""deg/s of the table."""


@dataclass(frozen=True)
class Turned(StillMotion):
    """Motion of a node on a table: turns about z as (begin, end, rad/s) on the board's clock.

    begun: estimates of the host time at which that clock was 0, s; lived: its present time, s.
    """

    begun: list = field(default_factory=list)
    lived: list = field(default_factory=lambda: [0.0])
    turns: list = field(default_factory=list)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    def angular_rate(self, t):
        gyro = self.rng.normal(0.0, 0.002, (len(t), 3))
        # The power-on time is the smallest estimate, as the board's clock is late but never early.
        self.begun.append(time.monotonic() - float(np.max(t)))
        self.lived[0] = float(np.max(t))
        for start, end, rate in list(self.turns):
            gyro[:, 2] += rate * ((t >= start) & (t < end))
        return gyro

    def specific_force(self, t):
        return np.tile([0.0, 0.0, STANDARD_GRAVITY], (len(t), 1))


@pytest.fixture
def bench(tmp_path):
    """Yield a node on a port and a turntable under it with speed SPEED."""
    micropython_or_skip()
    # The node is a thread of this process: loading 400 modules on a busy computer silences it for seconds.
    import_module("hubodo.verbs.north")
    motion = Turned()

    def turning(from_deg, to_deg, put):
        length = abs(to_deg - from_deg) / SPEED
        while not motion.begun:
            time.sleep(0.02)  # The board is powering on.
        start = time.monotonic()
        # Set slightly ahead, because the board creates its samples just before sending them.
        first = max(start - min(motion.begun), motion.lived[0]) + 0.2
        last = first + length
        motion.turns.append((first, last, math.radians(math.copysign(SPEED, to_deg - from_deg))))
        # The move does not end before the board, delayed by a busy computer, has measured all of it.
        while (share := (time.monotonic() - start) / (length + 0.4)) < 1.0 or motion.lived[0] < last:
            put(from_deg + min(share, 1.0) * (to_deg - from_deg))
            time.sleep(0.02)

    port = tmp_path / "tty"
    node = VirtualNode(
        motion,
        Flash(FIRMWARE, {"rate_hz": 104}),
        clock=Clock("paced"),
        host=Host("pty", path=port),
        own_process=False,
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
