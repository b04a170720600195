"""`hubodo flash` for many boards, with a pulled cable, and rollback, on virtual boards and real terminals."""

import json
import shutil
import threading

import pytest

import hubodo.flash.board
import hubodo.flash.fleet
import hubodo.verbs.flash as verb
from hubodo.cli import main
from hubodo.emulator.board.settings import BoardSettings
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.flash.board import FlashBoard
from hubodo.flash.image import firmware_folder
from hubodo.flash.slots import active_slot

SERIALS = ("e661410300000001", "e661410300000002", "e661410300000003")


class FakePort:
    """The attributes of pyserial's ListPortInfo that are used."""

    def __init__(self, device, vid):
        self.device, self.vid, self.serial_number = str(device), vid, None


@pytest.fixture(scope="module")
def boards():
    """Yield three boards with only MicroPython installed."""
    nodes = [VirtualNode(StillMotion(), board=BoardSettings(unique_id=serial)) for serial in SERIALS]
    try:
        yield [node.start() for node in nodes]
    finally:
        for node in nodes:
            node.stop()


def flash(capfd, *words):
    code = main(["flash", *map(str, words), "--json"])
    out, err = capfd.readouterr()
    return code, json.loads(out) if out else None, err


def runs_from(node):
    return active_slot((node.flash / "main.py").read_text())


def test_all_boards_get_the_names_of_the_table_and_one_that_fails_stops_no_other(
    boards, tmp_path, monkeypatch, capfd
):
    ports = [FakePort(boards[0].port, 0x2E8A), FakePort(tmp_path / "gone", 0x2E8A)]
    ports += [FakePort(board.port, 0x2E8A) for board in boards[1:]] + [FakePort("/dev/ttyGNSS", 0x1546)]
    monkeypatch.setattr(hubodo.flash.fleet.list_board_ports, "__defaults__", (lambda: ports,))
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(f'[nodes]\n{SERIALS[0]} = "left"\n{SERIALS[1].upper()} = "right"\n')
    code, report, err = flash(capfd, "--all", "--fleet", fleet)
    assert code == 1 and (report["done"], report["failed"]) == (2, 1), err
    by_port = {row["port"]: row for row in report["boards"]}
    assert [by_port[str(board.port)].get("node") for board in boards] == [1, 2, None]
    assert "gone" in by_port[str(tmp_path / "gone")]["error"]
    stranger = by_port[str(boards[2].port)]
    assert stranger["left_alone"] and SERIALS[2] in stranger["error"]
    assert not list(boards[2].flash.iterdir()), "what is in no table is left as it is"
    del ports[2:]
    assert main(["flash", "--all", "--fleet", str(fleet)]) == 1
    shown, _ = capfd.readouterr()
    assert "left" in shown and "FAILED" in shown
    boards[1].stop()  # no other test uses it, and it would sample beside them


def test_flashing_resumes_after_a_disconnection(boards, monkeypatch, capfd):
    board, sent, pieces = boards[2], [], hubodo.flash.board._pieces

    def pulled(content):
        sent.append(content)
        if len(sent) == 12:
            board.unplug()
            threading.Timer(0.5, board.replug).start()
        yield from pieces(content)

    monkeypatch.setattr(hubodo.flash.board, "_pieces", pulled)
    code, report, err = flash(capfd, board.port, "--node", "frame")
    assert code == 0, err
    assert report["went_away"] == 1 and report["node"] == 3
    assert len(sent) == report["files"] + 2, "sent twice: the file in which it was pulled, and the settings"
    board.stop()


def test_a_roll_back_runs_the_previous_firmware_and_a_second_one_the_newer(
    boards, tmp_path, monkeypatch, capfd
):
    board = boards[0]
    first = runs_from(board)
    code, _, err = flash(capfd, board.port, "--roll-back")
    assert code == 1 and "no complete older firmware to roll back to" in err, "there is one slot as yet"
    assert FlashBoard(board.port).wait_identity()[0] == 1, "it goes on with what it has"
    newer = tmp_path / "firmware"
    shutil.copytree(firmware_folder(), newer)
    (newer / "reports.py").write_text((newer / "reports.py").read_text().replace("(0, 1, 0)", "(9, 9, 9)"))
    monkeypatch.setattr(verb, "firmware_folder", lambda: newer)
    code, report, err = flash(capfd, board.port)
    assert code == 0 and report["firmware"] == "9.9.9", err
    assert runs_from(board) != first
    code, report, err = flash(capfd, board.port, "--roll-back")
    assert code == 0 and report["firmware"] == "0.1.0" and runs_from(board) == first, err
    code, report, err = flash(capfd, board.port, "--roll-back")
    assert code == 0 and report["firmware"] == "9.9.9", err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "name ports"),
        (("/dev/a", "/dev/b", "--node", "left"), "--fleet"),
        (("/dev/a", "--roll-back", "--node", "left"), "changes no settings"),
        (("/dev/a", "--set", "lnk=udp"), "is it link?"),
        (("/dev/a", "--set", "rate_hz=fast"), "must be int"),
        (("/dev/a", "--fleet", "/nowhere.toml"), "no such file"),
    ],
)
def test_wrong_usage_is_one_line_with_a_remedy(words, says, capfd):
    code, _, err = flash(capfd, *words)
    assert code == 2 and says in err and err.count("\n") == 1
