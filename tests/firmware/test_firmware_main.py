"""The first file that a node runs: no ctrl-C ends it, and of firmware in slots the first that loads runs."""

import ast
import itertools
import sys
import types
from functools import cache

import pytest

from virtual_runs import FIRMWARE

MAIN = FIRMWARE / "main.py"


@cache
def code_of(slots=None):
    """main.py with a call of `tick` before each of its statements; with `slots` named in it, as flashed."""

    class Ticking(ast.NodeTransformer):
        def generic_visit(self, node):
            super().generic_visit(node)
            for name in ("body", "orelse", "finalbody"):
                if isinstance(body := getattr(node, name, None), list) and body:
                    ticks = ast.parse("tick()\n" * len(body)).body
                    setattr(node, name, list(itertools.chain(*zip(ticks, body, strict=True))))
            return node

    text = MAIN.read_text()
    if slots is not None:
        assert text.count('SLOTS = ("",)') == 1
        text = text.replace('SLOTS = ("",)', f"SLOTS = {slots!r}")
    tree = Ticking().visit(ast.parse(text))
    return compile(ast.fix_missing_locations(tree), str(MAIN), "exec")


@pytest.fixture(autouse=True)
def _modules_as_before(monkeypatch):
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    before = dict(sys.modules)
    # After power-on nothing is loaded; other tests of this process have loaded the firmware.
    for name, module in before.items():
        if str(getattr(module, "__file__", None) or "").startswith(str(FIRMWARE)):
            del sys.modules[name]
    yield
    sys.modules.clear()
    sys.modules.update(before)


class Interrupted:
    """Runs main.py; ctrl-C comes before given statements, and is raised some later, as ports do.

    A port looks for it at jumps, in calls and in sleeps. Until then it pends, whatever `kbd_intr` says in
    the meantime.
    """

    def __init__(self, comes, delay):
        self.comes, self.delay = comes, delay
        self.char = 3
        self.count = 0
        self.raise_at = None
        self.started = 0
        self.slept = []

    def run(self, slots=None):
        sys.modules["micropython"] = types.SimpleNamespace(kbd_intr=lambda char: setattr(self, "char", char))
        sys.modules["time"] = types.SimpleNamespace(sleep_ms=self.sleep_ms)
        if slots is None:
            sys.modules["node"] = types.SimpleNamespace(main=self.main)
        exec(code_of(slots), {"__name__": "__main__", "tick": self.tick})

    def tick(self):
        self.count += 1
        if self.count in self.comes and self.char == 3:
            self.raise_at = self.raise_at or self.count + self.delay
        self.poll(self.count)

    def poll(self, count):
        if self.raise_at is not None and count >= max(self.raise_at, FIRST_CALL):
            self.raise_at = None
            raise KeyboardInterrupt

    def sleep_ms(self, ms):
        self.slept.append(ms)
        self.poll(1 << 30)

    def main(self):
        assert self.char == -1, "ctrl-C is an ordinary byte when the node starts"
        assert self.raise_at is None, "and none pends"
        self.started += 1


FIRST_CALL, STATEMENTS = 5, 26
"""Statements in the order in which they run: before the first call things are only named; then the end."""


@pytest.mark.parametrize("delay", [0, 1, 2, 5, 100])
def test_the_node_starts_once_wherever_two_ctrl_c_come_and_however_late_they_are_raised(delay):
    for first in range(1, STATEMENTS):
        for second in (0, *range(first + 1, STATEMENTS)):
            interrupted = Interrupted({first, second}, delay)
            try:
                interrupted.run()
            except KeyboardInterrupt:
                pytest.fail(f"ctrl-C at statements {first} and {second} ends at the prompt")
            assert interrupted.started == 1, (first, second)


def test_a_ctrl_c_that_pends_is_waited_for_where_no_other_can_come():
    """A millisecond: as long as a host takes for the next."""
    plain = Interrupted(set(), 0)
    plain.run()
    assert plain.slept == [1]


@pytest.fixture
def slots(tmp_path):
    """Two folders of firmware whose node has said where it ran; what each is to hold may be given."""
    ran = []
    sys.modules["told"] = types.SimpleNamespace(ran=ran)

    def made(*nodes):
        for name, text in zip("abc", nodes, strict=False):
            (tmp_path / name).mkdir()
            (tmp_path / name / "part.py").write_text(f"WHOSE = {name!r}\n")
            (tmp_path / name / "node.py").write_text(text)
        return tuple(str(tmp_path / name) for name in "abc"[: len(nodes)]), ran

    return made


SOUND = "import part, told\ndef main():\n    told.ran.append(part.WHOSE)\n"
BROKEN = "import part\nimport other_that_nobody_has\n"


@pytest.mark.parametrize(
    "nodes, runs",
    [([SOUND], "a"), ([SOUND, SOUND], "a"), ([BROKEN, SOUND], "b"), ([BROKEN, BROKEN, SOUND], "c")],
)
def test_the_first_slot_that_loads_runs_with_parts_of_its_own_alone(slots, capsys, monkeypatch, nodes, runs):
    calls = []
    monkeypatch.setattr(sys, "print_exception", calls.append, raising=False)
    known = types.ModuleType("known_before")
    sys.modules["known_before"] = known
    folders, ran = slots(*nodes)
    Interrupted(set(), 0).run(folders)
    assert ran == [runs] and sys.path[0] == folders["abc".index(runs)]
    assert [type(error) for error in calls] == [ModuleNotFoundError] * "abc".index(runs)
    assert sys.modules["known_before"] is known


@pytest.mark.parametrize("nodes", [[BROKEN], [BROKEN, BROKEN]])
def test_where_no_slot_loads_the_last_error_is_told(slots, monkeypatch, nodes):
    """At the prompt, which is where a board without firmware that runs has to end."""
    calls = []
    monkeypatch.setattr(sys, "print_exception", calls.append, raising=False)
    folders, ran = slots(*nodes)
    with pytest.raises(ModuleNotFoundError, match="nobody_has"):
        Interrupted(set(), 0).run(folders)
    assert not ran and len(calls) == len(nodes) - 1
