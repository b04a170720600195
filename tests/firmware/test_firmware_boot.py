"""Ctrl-C while a node boots: hosts send any byte, and two to be sure; no node ends at the prompt for it."""

import pytest

from hubodo.emulator.board.settings import BoardSettings
from hubowire import messages as m
from virtual_runs import matched, of, request, run

STEPS_MS = [0, 0.01, 0.03, 0.1, 0.3, 0.6, *range(1, 16), 20, 30, 50, 100]
"""Main.py begins at 0."""


def boots(seconds, script, **settings):
    """What a node that gets `script` sends; it must be sampling at the end, and answer."""
    asked = [(seconds - 0.3, b"\0" + request(1, m.Ping()))]
    sent, truth, stats = run(seconds, script=[*script, *asked], **settings)
    assert stats["counts"].get("at_prompt", 0) == 0, "the prompt came"
    assert stats["resets"] == []
    assert [ack.request_seq for ack in of(sent, m.Ack)] == [1]
    assert truth.t[int(matched(sent, truth)[-1, 0])] > seconds - 0.1
    return sent


@pytest.mark.parametrize("interpreter", ["micropython", "cpython"])
def test_ctrl_c_at_any_moment_of_the_boot_does_not_strand_the_node(interpreter):
    for at in STEPS_MS:
        again = at + (0.05 if at < 1 else 1)
        script = [(at / 1000, b"\x03"), (again / 1000, b"\x03\x03")]
        boots(0.5, script, board=BoardSettings(interpreter=interpreter))


@pytest.mark.parametrize("interpreter", ["micropython", "cpython"])
def test_a_host_that_sends_ctrl_c_all_the_time_does_not_keep_a_node_from_booting(interpreter):
    boots(1, [(0.0005 * i, b"\x03") for i in range(1200)], board=BoardSettings(interpreter=interpreter))
