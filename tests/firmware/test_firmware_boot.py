"""Ctrl-C while a node boots: hosts send any byte, and two to be sure; no node ends at the prompt for it."""

import sys
import types
from pathlib import Path

import pytest

from hubodo.emulator.board.settings import BoardSettings
from hubowire import messages as m
from virtual_runs import FIRMWARE, matched, of, request, run

MAIN = FIRMWARE / "main.py"
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


class Interrupted:
    """Runs main.py line by line; ctrl-C comes at given lines, and is raised some lines later as ports do.

    A port looks for it at jumps, in calls and in sleeps. Until then it pends, whatever `kbd_intr` says in
    the meantime.
    """

    def __init__(self, comes, delay):
        self.comes, self.delay = comes, delay
        self.char = 3
        self.line = 0
        self.raise_at = None
        self.started = 0

    def run(self):
        modules = {
            "micropython": types.SimpleNamespace(kbd_intr=lambda char: setattr(self, "char", char)),
            "time": types.SimpleNamespace(sleep_ms=self.sleep_ms),
            "node": types.SimpleNamespace(main=self.main),
        }
        saved = {name: sys.modules.get(name) for name in modules}
        code = compile(MAIN.read_text(), str(MAIN), "exec")
        traced = sys.gettrace()
        sys.modules.update(modules)
        try:
            sys.settrace(self.trace)
            exec(code, {"__name__": "__main__"})
        finally:
            sys.settrace(traced)
            for name, module in saved.items():
                if module is None:
                    del sys.modules[name]
                else:
                    sys.modules[name] = module

    def trace(self, frame, event, _):
        if Path(frame.f_code.co_filename) == MAIN and event in ("call", "line"):
            if event == "line":
                self.line += 1
                if self.line in self.comes and self.char == 3:
                    self.raise_at = self.raise_at or self.line + self.delay
                self.look(self.line)
            return self.trace
        return None

    def look(self, line):
        if self.raise_at is not None and line >= max(self.raise_at, FIRST_CALL):
            self.raise_at = None
            raise KeyboardInterrupt

    def sleep_ms(self, ms):
        self.look(1 << 30)

    def main(self):
        assert self.char == -1, "ctrl-C is an ordinary byte when the node starts"
        assert self.raise_at is None, "and none pends"
        self.started += 1


FIRST_CALL, LINES = 5, 18
"""Lines in the order in which main.py runs them: before the first call it only names things; then its end."""


@pytest.mark.parametrize("delay", [0, 1, 2, 5, 100])
def test_main_starts_the_node_once_wherever_a_ctrl_c_comes_and_however_late_it_is_raised(delay):
    for first in range(1, LINES):
        for second in (0, *range(first + 1, LINES)):
            interrupted = Interrupted({first, second}, delay)
            try:
                interrupted.run()
            except KeyboardInterrupt:
                pytest.fail(f"ctrl-C at lines {first} and {second} ends at the prompt")
            assert interrupted.started == 1, (first, second)
