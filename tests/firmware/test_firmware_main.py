"""main.py of the node: ctrl-C never ends it, and the first firmware slot that loads is run."""

import ast
import itertools
import sys
import types
from functools import cache

import pytest

from virtual_runs import FIRMWARE

MAIN = FIRMWARE / "main.py"


@cache
def compile_main(slots=None):
    """Compile main.py with a call of `tick` before each statement, and with the given slots."""

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
def _fresh_modules(monkeypatch):
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    before = dict(sys.modules)
    # After power-on no module is loaded, while other tests of this process have loaded the firmware.
    for name, module in before.items():
        if str(getattr(module, "__file__", None) or "").startswith(str(FIRMWARE)):
            del sys.modules[name]
    yield
    sys.modules.clear()
    sys.modules.update(before)


class InterruptedMain:
    """Runs main.py with ctrl-C before given statements; the exception is raised later, as on real ports.

    A port checks for ctrl-C at jumps, calls and sleeps. Until then it is pending, even if `kbd_intr`
    disables it in the meantime.
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
        exec(compile_main(slots), {"__name__": "__main__", "tick": self.tick})

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
        assert self.raise_at is None, "no ctrl-C is pending"
        self.started += 1


FIRST_CALL, STATEMENTS = 5, 26
"""Number of the first statement with a call, and of all statements, in the order of execution."""


@pytest.mark.parametrize("delay", [0, 1, 2, 5, 100])
def test_the_node_starts_once_with_two_ctrl_c_at_any_statements_and_any_delay(delay):
    for first in range(1, STATEMENTS):
        for second in (0, *range(first + 1, STATEMENTS)):
            interrupted = InterruptedMain({first, second}, delay)
            try:
                interrupted.run()
            except KeyboardInterrupt:
                pytest.fail(f"ctrl-C at statements {first} and {second} ends at the prompt")
            assert interrupted.started == 1, (first, second)


def test_main_waits_for_a_pending_ctrl_c():
    """main.py waits for 1 ms, in which a pending ctrl-C is raised."""
    plain = InterruptedMain(set(), 0)
    plain.run()
    assert plain.slept == [1]


@pytest.fixture
def slots(tmp_path):
    """Return a function that creates firmware slots; each node records its slot when it runs."""
    ran = []
    sys.modules["run_record"] = types.SimpleNamespace(ran=ran)

    def create_slots(*nodes):
        for name, text in zip("abc", nodes, strict=False):
            (tmp_path / name).mkdir()
            (tmp_path / name / "part.py").write_text(f"SLOT = {name!r}\n")
            (tmp_path / name / "node.py").write_text(text)
        return tuple(str(tmp_path / name) for name in "abc"[: len(nodes)]), ran

    return create_slots


VALID = "import part, run_record\ndef main():\n    run_record.ran.append(part.SLOT)\n"
BROKEN = "import part\nimport other_that_nobody_has\n"


@pytest.mark.parametrize(
    "nodes, runs",
    [([VALID], "a"), ([VALID, VALID], "a"), ([BROKEN, VALID], "b"), ([BROKEN, BROKEN, VALID], "c")],
)
def test_the_first_slot_that_loads_runs_with_its_own_modules(slots, capsys, monkeypatch, nodes, runs):
    calls = []
    monkeypatch.setattr(sys, "print_exception", calls.append, raising=False)
    known = types.ModuleType("known_before")
    sys.modules["known_before"] = known
    folders, ran = slots(*nodes)
    InterruptedMain(set(), 0).run(folders)
    assert ran == [runs] and sys.path[0] == folders["abc".index(runs)]
    assert [type(error) for error in calls] == [ModuleNotFoundError] * "abc".index(runs)
    assert sys.modules["known_before"] is known


@pytest.mark.parametrize("nodes", [[BROKEN], [BROKEN, BROKEN]])
def test_if_no_slot_loads_the_last_error_is_raised(slots, monkeypatch, nodes):
    """The error ends at the prompt, where a board without working firmware has to end."""
    calls = []
    monkeypatch.setattr(sys, "print_exception", calls.append, raising=False)
    folders, ran = slots(*nodes)
    with pytest.raises(ModuleNotFoundError, match="nobody_has"):
        InterruptedMain(set(), 0).run(folders)
    assert not ran and len(calls) == len(nodes) - 1
