"""Shell completion of files, nodes and ports."""

import argparse
from pathlib import Path

import numpy as np
import pytest

from hubodo.effects import EFFECTS
from hubodo.log.recording_writer import write_recording
from hubodo.recording import NODE_COLUMNS, Recording, Table
from hubodo.verbs import completers
from hubodo.verbs.completers import _attach_completers, _Files, _nodes, _ports, typed_words


def _completer(*words: str, **options: object) -> completers.Completer | None:
    parser = argparse.ArgumentParser()
    action = parser.add_argument(*words, **options)  # type: ignore[arg-type]
    _attach_completers(parser)
    return getattr(action, "completer", None)


def _ride(path: Path) -> Path:
    table = Table({name: np.arange(5.0) for name in NODE_COLUMNS})
    write_recording(Recording({"right": table, "frame": table}), path)
    return path


@pytest.mark.parametrize(
    ("line", "point", "words"),
    [
        ("hubodo fuse ri", None, ["fuse"]),
        ("hubodo fuse 'my ride.mcap' --o", None, ["fuse", "my ride.mcap"]),
        ("hubodo fuse ride.mcap --out", "12", ["fuse"]),
    ],
)
def test_complete_words_are_those_before_the_one_at_the_cursor(
    monkeypatch: pytest.MonkeyPatch, line: str, point: str | None, words: list[str]
) -> None:
    monkeypatch.setenv("COMP_LINE", line)
    monkeypatch.setenv("COMP_POINT", point or str(len(line)))
    assert typed_words() == words


def test_files_have_one_of_the_suffixes_and_folders_end_in_a_slash(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.MCAP", "c.txt", ".hidden.mcap"):
        (tmp_path / name).touch()
    (tmp_path / "folder").mkdir()
    offered = _Files(".mcap")(f"{tmp_path}/")
    assert offered == [f"{tmp_path}/{name}" for name in ("a.mcap", "b.MCAP", "folder/")]
    assert _Files(".mcap")(f"{tmp_path}/.h") == [f"{tmp_path}/.hidden.mcap"]
    assert _Files()(f"{tmp_path}/c") == [f"{tmp_path}/c.txt"]
    assert _Files()(f"{tmp_path}/missing/x") == []


def test_arguments_are_completed_by_what_they_stand_for() -> None:
    log = _completer("log", metavar="LOG", type=Path)
    assert isinstance(log, _Files)
    assert _completer("--vehicle", metavar="TOML", type=Path)._suffixes == (".toml",)  # type: ignore[union-attr]
    assert _completer("--port", metavar="PORT") is _ports
    assert _completer("--nodes") is _nodes
    # A number has no completions; a choice has those of argparse.
    assert _completer("--rate", metavar="HZ", type=float)("", parsed_args=None) == []  # type: ignore[misc]
    assert _completer("--format", choices=("a", "b")) is None
    effects = _completer("--explain", metavar="EFFECT")
    assert effects("") == [effect.name for effect in EFFECTS]  # type: ignore[misc]


def test_nodes_are_those_of_the_log_and_else_the_usual_ones(tmp_path: Path) -> None:
    log = _ride(tmp_path / "ride.mcap")
    assert _nodes("", argparse.Namespace(log=log)) == ["frame", "right"]
    assert _nodes("right,", argparse.Namespace(log=[log])) == ["right,frame", "right,right"]
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no log")
    for namespace in (argparse.Namespace(), argparse.Namespace(log=broken), argparse.Namespace(log=None)):
        assert "left" in _nodes("", namespace)


def test_nodes_of_a_csv_folder_are_its_files_without_roles(tmp_path: Path) -> None:
    for name in ("left.csv", "frame.csv.gz", "gnss.csv", "truth.csv", "notes.txt"):
        (tmp_path / name).touch()
    assert _nodes("", argparse.Namespace(log=tmp_path)) == ["frame", "left"]


def test_ports_are_devices_serial_numbers_and_schemes_behind_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    ports = [
        argparse.Namespace(device="/dev/ttyACM0", serial_number="e661"),
        argparse.Namespace(device="/dev/ttyS0", serial_number=None),
    ]
    monkeypatch.setattr(completers, "list_devices", lambda: ports)
    offered = ["/dev/ttyACM0", "e661", "/dev/ttyS0", "udp://0.0.0.0:", "ble://hubodo-", "socket://"]
    assert _ports("")[-6:] == offered and "left=" in _ports("")
    assert _ports("left=/d") == [f"left={port}" for port in offered]
