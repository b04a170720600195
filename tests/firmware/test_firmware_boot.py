"""Ctrl-C while a node boots: a node never ends at the prompt, even if the host repeats it."""

import pytest

from hubodo.emulator.board.settings import BoardSettings
from hubowire import messages as m
from repetitions import first_and_more
from virtual_runs import match_samples, messages_of, request, run

STEPS_MS = [0, 0.01, 0.03, 0.1, 0.3, 0.6, *range(1, 16), 20, 30, 50, 100]
"""Times after the start of main.py."""


def assert_boots(seconds, script, **settings):
    """Boot a node that receives `script`; check that it samples and answers at the end."""
    ping = [(seconds - 0.3, b"\0" + request(1, m.Ping()))]
    sent, truth, stats = run(seconds, script=[*script, *ping], **settings)
    assert stats["counts"].get("at_prompt", 0) == 0, "the node ended at the prompt"
    assert stats["resets"] == []
    assert [ack.request_seq for ack in messages_of(sent, m.Ack)] == [1]
    assert truth.t[int(match_samples(sent, truth)[-1, 0])] > seconds - 0.1
    return sent


@pytest.mark.parametrize("interpreter", first_and_more("micropython", "cpython"))
def test_ctrl_c_at_any_time_of_the_boot_does_not_stop_the_node(interpreter):
    for at in STEPS_MS:
        again = at + (0.05 if at < 1 else 1)
        script = [(at / 1000, b"\x03"), (again / 1000, b"\x03\x03")]
        assert_boots(0.5, script, board=BoardSettings(interpreter=interpreter))


@pytest.mark.parametrize("interpreter", ["micropython", "cpython"])
def test_repeated_ctrl_c_does_not_prevent_booting(interpreter):
    assert_boots(
        1, [(0.0005 * i, b"\x03") for i in range(1200)], board=BoardSettings(interpreter=interpreter)
    )
