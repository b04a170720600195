"""A board in the hand, looked at in bring-up order: what is ok, wrong or unknown, and what to do about it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from hubodo.errors import LinkError
from hubodo.flash.board import BoardIdentity, FlashBoard
from hubodo.flash.check_result import CHECKS, CheckResult, ok, unknown, wrong
from hubodo.flash.image import build, digests, firmware_folder
from hubodo.flash.listen import Heard, listen
from hubodo.flash.prompt import FlashError
from hubodo.flash.slots import CONFIG, SLOTS, main_for, plan
from hubodo.flash.symptoms import judge, speech
from hubodo.flash.wires import board_pins, judge_wires, look
from hubowire.messages import Board

AT_LEAST = (1, 24)
"""MicroPython that the firmware needs."""
_COMES_BACK_S, _SETTLES_S = 10.0, 1.0


@dataclass(frozen=True)
class Examination:
    """The results on one port, in the order of CHECKS."""

    port: str
    results: tuple[CheckResult, ...]

    @property
    def healthy(self) -> bool:
        """Whether nothing is wrong."""
        return not any(result.verdict == "wrong" for result in self.results)


def examine(
    port: str, *, baud: int, seconds: float, repl: bool, note: Callable[[str], None] = lambda text: None
) -> Examination:
    """Looks at a port.

    repl: interrupt a node that runs, and look from within; a board that stands at its prompt is looked at so
    in any case, and then started when it has firmware. note: called with what is being done.
    """
    note("listening")
    try:
        heard = listen(port, baud, seconds, briefly=repl)
    except LinkError as error:
        what, _, remedy = str(error).removeprefix(f"{port}: ").partition("; ")
        return _complete(port, [wrong("port", what, remedy)])
    results = [ok("port", f"{port} opens")]
    if not heard.prompt and not (repl and heard.frames):
        return _complete(port, results + judge(heard, baud))
    note("looking from within")
    try:
        with FlashBoard(port) as board:
            within, has_firmware = _look_within(board)
    except FlashError as error:
        remedy = (
            "unplug the board, plug it in again; a node that sends by UART or Wi-Fi has its prompt on USB"
        )
        return _complete(port, [*results, speech(heard, baud), wrong("MicroPython", str(error), remedy)])
    if not has_firmware:
        return _complete(port, [*results, speech(heard, baud), *within])
    note("listening to the node")
    return _complete(port, results + within + judge(_listen_to_started(port, baud, seconds), baud))


def _look_within(board: FlashBoard) -> tuple[list[CheckResult], bool]:
    """What the REPL tells; with firmware on it the board is started, and that is said."""
    board.interrupt()
    seen, config = board.look(), board.config()
    kind, pins = board_pins(seen.machine, config)
    wires = judge_wires(look(pins, board.run))
    files, has_firmware = _files(board, seen)
    if has_firmware:
        board.reset()
    return [_interpreter(seen, kind, told="pins" in config), wires, files], has_firmware


def _interpreter(look: BoardIdentity, kind: Board, *, told: bool) -> CheckResult:
    text = f"{'.'.join(map(str, look.version))} on {look.machine or look.platform}"
    if look.version < AT_LEAST:
        wanted = ".".join(map(str, AT_LEAST))
        return wrong("MicroPython", text, f"install MicroPython {wanted} or later: micropython.org/download")
    if kind in (Board.OTHER, Board.RP2) and not told:
        remedy = (
            'if the sensor is not on GPIO4 (SDA) and 5 (SCL), say so in /config.json: {"pins": {"sda": ..}}'
        )
        return unknown("MicroPython", f"{text}: not a board that the table of pins has", remedy)
    return ok("MicroPython", text)


def _files(board: FlashBoard, look: BoardIdentity) -> tuple[CheckResult, bool]:
    """Whether the board runs the firmware of this host, and whether it has any."""
    image = build(firmware_folder(), look.architecture)
    held, running = board.survey(image)
    if not any(path.endswith(("/node.mpy", "/node.py")) for path in held):
        return wrong("files", "no firmware on the board", f"hubodo flash {board.port}"), False
    hashes = digests(image | {slot: main_for(image["main.py"], slot) for slot in SLOTS})
    todo = plan(image, hashes, held, running)
    if todo.slot is None:
        return ok("files", f"{len(image) - 1} files in {running}, each as this host builds it"), True
    where = running or "the root"
    differing = sorted(
        name
        for name in image
        if name not in (CONFIG, "main.py") and held.get(f"{running or ''}/{name}") != hashes[name]
    )
    some = ", ".join(differing[:4])
    text = f"in {where} {len(differing)} of {len(image) - 1} files differ from this host's: {some}"
    seen = (
        text
        if differing
        else f"in {where}: the files of this host, with another main.py or others beside them"
    )
    return wrong("files", seen, f"hubodo flash {board.port}"), True


def _listen_to_started(port: str, baud: int, seconds: float) -> Heard:
    """A board that has just been started: its port goes away and comes back, and its times settle first.

    One that is at its prompt again runs no firmware.
    """
    heard, end = Heard(), time.monotonic() + _COMES_BACK_S
    while time.monotonic() < end:
        try:
            settled = heard.frames > 0
            heard = listen(port, baud, seconds if settled else _SETTLES_S)
            if settled or heard.prompt:
                break
        except LinkError:
            time.sleep(0.2)
    return heard


def _complete(port: str, results: list[CheckResult]) -> Examination:
    """Every check once, in order; one that was left out is unknown, and says why."""
    by_name = {result.check: result for result in results}
    names = list(CHECKS)
    first_wrong = next((name for name in names if name in by_name and by_name[name].verdict == "wrong"), None)
    whole = []
    for name, reason in CHECKS.items():
        if first_wrong is not None and names.index(name) > names.index(first_wrong):
            reason = f"first put right what is wrong with: {first_wrong}"
        whole.append(by_name.get(name) or unknown(name, reason))
    return Examination(port, tuple(whole))
