"""Flashing a board: order of steps, disconnections, settings, and boards that are left as they were."""

from collections.abc import Callable
from pathlib import Path

import pytest

from fakes.node_messages import hello
from hubodo.errors import InputError
from hubodo.flash import install
from hubodo.flash.board import BoardIdentity
from hubodo.flash.install import install_firmware, roll_back
from hubodo.flash.order import CONFIG, SettingsOrder
from hubodo.flash.prompt import BoardDisconnected, FlashError
from hubowire import FINGERPRINT

PORT, SERIAL = "/dev/ttyFAKE", "0011223344556677"


class FakeBoard:
    """A board that records what is done to it; `fail` raises in the named step, once for each exception."""

    def __init__(self, config: dict[str, object] | None = None, **failures: list[Exception]) -> None:
        self.steps: list[str] = []
        self.present, self.image = config or {}, dict[str, bytes]()
        self._failures = failures

    def __call__(self, port: str) -> "FakeBoard":
        assert port == PORT
        return self

    def __enter__(self) -> "FakeBoard":
        return self

    def __exit__(self, *_: object) -> None:
        self.steps.append("close")

    def _step(self, name: str) -> None:
        self.steps.append(name)
        if self._failures.get(name):
            raise self._failures[name].pop(0)

    def interrupt(self) -> None:
        self._step("interrupt")

    def identify(self) -> BoardIdentity:
        self._step("identify")
        return BoardIdentity("rp2", "Raspberry Pi Pico", "armv6m", (1, 24, 0), "3.4.0; MicroPython v1.24.0")

    def unique_id(self) -> str:
        return SERIAL

    def config(self) -> dict[str, object]:
        return self.present

    def copy(self, image: dict[str, bytes], progress: Callable[[str], None]) -> list[str]:
        self._step("copy")
        self.image = image
        progress("1 of 1 files: main.py")
        return ["main.py"]

    def reset(self) -> None:
        self._step("reset")

    def wait_hello(self) -> tuple[int, object]:
        self._step("hello")
        return 2, hello()

    def wait_identity(self, timeout: float = 0.0) -> tuple[int, int, tuple[int, ...]]:
        self._step("identity")
        return 2, 0xABCDEF01, (0, 9, 0)

    def roll_back(self) -> None:
        self._step("roll back")


@pytest.fixture
def flash(monkeypatch: pytest.MonkeyPatch) -> Callable[[FakeBoard], list[str]]:
    """Return a function that flashes a board with settings and returns what was reported."""
    monkeypatch.setattr(
        install, "build_image", lambda folder, architecture: {"main.py": b"x", "node.py": b"y"}
    )
    monkeypatch.setattr(install, "add_manifest", lambda image: dict(image))
    monkeypatch.setattr(install, "_wait_for_port", lambda port: True)
    monkeypatch.setattr(install, "_POLL_PERIOD_S", 0.0)

    def run(board: FakeBoard, **settings: object) -> list[str]:
        monkeypatch.setattr(install, "FlashBoard", board)
        reports: list[str] = []
        run.result = install_firmware(
            PORT, lambda serial: SettingsOrder(settings), Path("firmware"), reports.append
        )  # type: ignore[attr-defined]
        return reports

    return run


def test_the_node_runs_until_its_files_are_copied_and_is_identified_afterwards(flash) -> None:
    board = FakeBoard()
    reports = flash(board)
    assert board.steps == ["interrupt", "identify", "copy", "reset", "hello", "close"]
    assert CONFIG not in board.image
    assert f"{PORT}: compiling for armv6m" in reports
    assert reports[-2:] == [f"{PORT}: copying 1 of 1 files: main.py", f"{PORT}: starting"]
    result = flash.result.as_json()
    assert (result["files"], result["copied"], result["node"], result["went_away"]) == (2, ["main.py"], 2, 0)
    assert (result["firmware"], result["fingerprint"]) == ("1.4.2", f"{FINGERPRINT:08x}")


def test_settings_are_merged_into_those_of_the_board(flash) -> None:
    board = FakeBoard({"ssid": "shed", "rate_hz": 416})
    flash(board, rate_hz=104)
    assert board.image[CONFIG] in (b'{"ssid":"shed","rate_hz":104}', b'{"ssid": "shed", "rate_hz": 104}')
    assert flash.result.files == 3 and not flash.result.keyed


def test_a_board_that_disconnects_is_flashed_on_once_its_port_is_back(flash) -> None:
    board = FakeBoard(
        copy=[BoardDisconnected("unplugged"), BoardDisconnected("unplugged")],
        # The port that has just returned is not ready at once.
        interrupt=[],
    )
    reports = flash(board)
    assert board.steps.count("copy") == 3
    assert sum("reconnect the cable" in line for line in reports) == 2
    assert flash.result.n_disconnections == 2


def test_a_board_whose_port_does_not_return_or_that_disconnects_forever_is_given_up(
    flash, monkeypatch: pytest.MonkeyPatch
) -> None:
    board = FakeBoard(copy=[BoardDisconnected("unplugged") for _ in range(99)])
    with pytest.raises(BoardDisconnected):
        flash(board)
    assert board.steps.count("copy") == install._MAX_RECONNECTIONS + 1
    monkeypatch.setattr(install, "_wait_for_port", lambda port: False)
    board = FakeBoard(copy=[BoardDisconnected("unplugged")])
    with pytest.raises(BoardDisconnected):
        flash(board)
    assert board.steps.count("copy") == 1


def test_a_refused_order_leaves_the_board_running_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    board = FakeBoard()
    monkeypatch.setattr(install, "FlashBoard", board)

    def order(serial: str) -> SettingsOrder:
        raise InputError(f"no calibration of {serial}")

    with pytest.raises(InputError, match=SERIAL):
        install_firmware(PORT, order, Path("firmware"), lambda line: None)
    assert board.steps == ["interrupt", "identify", "reset", "identity", "close"]


def test_a_rollback_starts_the_previous_firmware_of_whatever_version(monkeypatch: pytest.MonkeyPatch) -> None:
    board = FakeBoard()
    monkeypatch.setattr(install, "FlashBoard", board)
    result = roll_back(PORT, lambda line: None)
    assert board.steps == ["interrupt", "roll back", "reset", "identity", "close"]
    assert result.is_other_version
    assert result.as_json() == {
        "port": PORT,
        "node": 2,
        "firmware": "0.9.0",
        "fingerprint": "abcdef01",
        "other_version": True,
    }


def test_a_board_without_previous_firmware_is_restarted(monkeypatch: pytest.MonkeyPatch) -> None:
    board = FakeBoard(**{"roll back": [FlashError("no older firmware")], "identity": [FlashError("silent")]})
    monkeypatch.setattr(install, "FlashBoard", board)
    with pytest.raises(FlashError, match="no older firmware"):
        roll_back(PORT, lambda line: None)
    assert board.steps[-3:] == ["reset", "identity", "close"]
