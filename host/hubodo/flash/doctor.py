"""Diagnosis of a board in bring-up order, with a remedy for each problem."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from hubodo.errors import LinkError
from hubodo.flash.board import BoardIdentity, FlashBoard
from hubodo.flash.check_result import CHECKS, CheckResult, failed_check, passed_check, unknown_check
from hubodo.flash.image import build_image, firmware_folder, hash_files
from hubodo.flash.prompt import FlashError
from hubodo.flash.reception import Reception, listen
from hubodo.flash.reception_checks import check_protocol, check_reception
from hubodo.flash.slots import CONFIG, SLOTS, main_for_slot, plan_flash
from hubodo.flash.wiring import check_wiring, find_board_pins, measure_lines
from hubowire.messages import Board

MIN_MICROPYTHON = (1, 24)
"""Oldest MicroPython that the firmware supports."""
_PORT_RETURN_TIMEOUT_S, _SETTLING_S = 10.0, 1.0


@dataclass(frozen=True)
class Examination:
    """The results of the checks on one port, in the order of CHECKS."""

    port: str
    results: tuple[CheckResult, ...]

    @property
    def is_healthy(self) -> bool:
        """Return True if no check failed."""
        return not any(result.verdict == "wrong" for result in self.results)


def examine(
    port: str,
    *,
    baud: int,
    seconds: float,
    repl: bool,
    report_step: Callable[[str], None] = lambda text: None,
) -> Examination:
    """Diagnose the board on a port.

    repl: interrupt a running node to check it over its prompt; a board at its prompt is always checked
    so, and started afterwards if it has firmware. report_step: called with each step.
    """
    report_step("listening")
    try:
        reception = listen(port, baud, seconds, briefly=repl)
    except LinkError as error:
        problem, _, remedy = str(error).removeprefix(f"{port}: ").partition("; ")
        return _complete(port, [failed_check("port", problem, remedy)])
    results = [passed_check("port", f"{port} opens")]
    if not reception.has_prompt and not (repl and reception.n_frames):
        return _complete(port, results + check_reception(reception, baud))
    report_step("checking over the prompt")
    try:
        with FlashBoard(port) as board:
            prompt_results, has_firmware = _check_over_prompt(board)
    except FlashError as error:
        remedy = "reconnect the board; a node that sends by UART or Wi-Fi has its prompt on USB"
        return _complete(
            port, [*results, check_protocol(reception, baud), failed_check("MicroPython", str(error), remedy)]
        )
    if not has_firmware:
        return _complete(port, [*results, check_protocol(reception, baud), *prompt_results])
    report_step("listening to the node")
    return _complete(
        port, results + prompt_results + check_reception(_listen_to_started(port, baud, seconds), baud)
    )


def _check_over_prompt(board: FlashBoard) -> tuple[list[CheckResult], bool]:
    """Return the results over the prompt, and True if the board has firmware, which is then started."""
    board.interrupt()
    identity, config = board.identify(), board.config()
    kind, pins = find_board_pins(identity.machine, config)
    wires = check_wiring(measure_lines(pins, board.run))
    files, has_firmware = _files(board, identity)
    if has_firmware:
        board.reset()
    return [_interpreter(identity, kind, has_pin_setting="pins" in config), wires, files], has_firmware


def _interpreter(identity: BoardIdentity, kind: Board, *, has_pin_setting: bool) -> CheckResult:
    text = f"{'.'.join(map(str, identity.version))} on {identity.machine or identity.platform}"
    if identity.version < MIN_MICROPYTHON:
        oldest = ".".join(map(str, MIN_MICROPYTHON))
        return failed_check(
            "MicroPython", text, f"install MicroPython {oldest} or later: micropython.org/download"
        )
    if kind in (Board.OTHER, Board.RP2) and not has_pin_setting:
        remedy = 'if the sensor is not on GPIO4 (SDA) and 5 (SCL), set /config.json: {"pins": {"sda": ..}}'
        return unknown_check("MicroPython", f"{text}: unknown board without default pins", remedy)
    return passed_check("MicroPython", text)


def _files(board: FlashBoard, identity: BoardIdentity) -> tuple[CheckResult, bool]:
    """Return the check of the board's firmware against this host's, and True if the board has any."""
    image = build_image(firmware_folder(), identity.architecture)
    held, running = board.list_hashes(image)
    if not any(path.endswith(("/node.mpy", "/node.py")) for path in held):
        return failed_check("files", "no firmware on the board", f"hubodo flash {board.port}"), False
    hashes = hash_files(image | {slot: main_for_slot(image["main.py"], slot) for slot in SLOTS})
    flash_plan = plan_flash(image, hashes, held, running)
    if flash_plan.slot is None:
        return passed_check("files", f"{len(image) - 1} files in {running}, identical to this host's"), True
    location = running or "the root"
    differing = sorted(
        name
        for name in image
        if name not in (CONFIG, "main.py") and held.get(f"{running or ''}/{name}") != hashes[name]
    )
    examples = ", ".join(differing[:4])
    text = f"in {location} {len(differing)} of {len(image) - 1} files differ from this host's: {examples}"
    observation = (
        text
        if differing
        else f"in {location}: the files of this host, but another main.py or additional files"
    )
    return failed_check("files", observation, f"hubodo flash {board.port}"), True


def _listen_to_started(port: str, baud: int, seconds: float) -> Reception:
    """Listen to a board that has just been started, whose port disappears and returns.

    A board that is at its prompt again runs no firmware.
    """
    reception, end = Reception(), time.monotonic() + _PORT_RETURN_TIMEOUT_S
    while time.monotonic() < end:
        try:
            is_settled = reception.n_frames > 0
            reception = listen(port, baud, seconds if is_settled else _SETTLING_S)
            if is_settled or reception.has_prompt:
                break
        except LinkError:
            time.sleep(0.2)
    return reception


def _complete(port: str, results: list[CheckResult]) -> Examination:
    """Return every check once, in order; a skipped one is unknown, with the reason."""
    by_name = {result.check: result for result in results}
    names = list(CHECKS)
    first_wrong = next((name for name in names if name in by_name and by_name[name].verdict == "wrong"), None)
    complete = []
    for name, reason in CHECKS.items():
        if first_wrong is not None and names.index(name) > names.index(first_wrong):
            reason = f"first fix: {first_wrong}"
        complete.append(by_name.get(name) or unknown_check(name, reason))
    return Examination(port, tuple(complete))
