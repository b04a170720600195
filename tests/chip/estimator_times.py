"""Time the estimators of a node on an emulated Pico, beside the times of Shah et al."""

import re
from dataclasses import dataclass
from pathlib import Path
from shutil import copytree

from rich.table import Table

from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host
from hubodo.emulator.interpreters.rp2040.pico import PicoSettings
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode

SECONDS = 4.0
# Table I of the paper, ms: an update of one axis, on a board that the paper does not name there.
PAPER_US = {"Kalman": 163.0, "RLS": 95.5}
# Program that runs in place of the node: each printed line is name, samples, total microseconds.
PROGRAM = """
import gc, time
from array import array
import bias_choice, bias_filter, micropython, settings

class clock:
    period_ns = 2403846

table = array("h", ((k * 37 + i * 11) % 60 - 30 for k in range(16) for i in range(6)))

def row(what, samples, work):
    gc.collect()
    begun = time.ticks_us()
    for _ in range(64):
        nothing()
    empty = time.ticks_diff(time.ticks_us(), begun)
    begun = time.ticks_us()
    for _ in range(64):
        work()
    print("row", what, 64 * samples, time.ticks_diff(time.ticks_us(), begun) - empty)

def nothing():
    pass

def estimator(kind):
    made = bias_choice.estimator(dict(settings.DEFAULTS, filter_kind=kind))
    for axis in range(3):
        made.reset(axis, 0)
    return made

kalman, rls = estimator(1), estimator(2)
axis = kalman._axes[2]
row("Kalman: one axis, one sample a call", 1, lambda: bias_filter.kalman(table, 2, 8, axis))
row("Kalman: three axes, one sample a call", 1, lambda: kalman.update(table, 0, 1))
row("Kalman: three axes, batches of 16", 16, lambda: kalman.update(table, 0, 16))
row("RLS: three axes, one sample a call", 1, lambda: rls.update(table, 0, 1))
row("RLS: three axes, batches of 16", 16, lambda: rls.update(table, 0, 16))
for kind, name in enumerate(("mean", "rest", "table", "gravity")):
    init = bias_choice.initialisation(dict(settings.DEFAULTS, bias_kind=kind, bias_stretch=1024), clock)
    init.start(60000, 70000000, 488000)
    init.update(table, 0, 8)
    row("initialisation: " + name, 8, lambda: init.update(table, 0, 8))
print("over")
"""


@dataclass(frozen=True)
class EstimatorTime:
    """Processing time of one sample by an estimator, µs."""

    what: str
    us: float


def estimator_times(firmware: Path, scratch: Path, pico: PicoSettings) -> list[EstimatorTime]:
    """Time the estimators with the clock of the board.

    firmware: as flashed. Raise RuntimeError if that fails.
    """
    folder = scratch / "estimators"
    copytree(firmware, folder)
    (folder / "main.py").write_text(_place(folder) + PROGRAM)
    with VirtualNode(
        StillMotion(),
        Flash(folder),
        clock=Clock("stepped", run_for=SECONDS),
        host=Host("memory"),
        board=BoardSettings(interpreter="rp2040", pico=pico),
    ) as node:
        node.wait(120)
        output = node.output.decode(errors="replace")
    rows = re.findall(r"^row (.+) (\d+) (\d+)\r?$", output, re.MULTILINE)
    if "over" not in output:
        raise RuntimeError(f"the estimators could not be timed: {output[-300:]}")
    return [EstimatorTime(what, int(us) / int(samples)) for what, samples, us in rows]


def _place(folder: Path) -> str:
    """Return the code that puts the firmware on sys.path, as main.py does."""
    slots = sorted(path.name for path in folder.glob("fw_?"))
    return f"import sys\nsys.path[0] = '/{slots[0]}'\n" if slots else ""


def table(rows: list[EstimatorTime]) -> Table:
    shown = Table("estimator", "a sample", "the paper's, one axis", title="estimators on the node")
    for row in rows:
        paper = PAPER_US.get(row.what.partition(":")[0])
        shown.add_row(row.what, f"{row.us:.1f} µs", "-" if paper is None else f"{paper:.0f} µs")
    return shown
