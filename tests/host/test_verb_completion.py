"""What the shell offers while `hubodo ...` is typed."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from fakes.recorder_thread import Device
from hubodo.cli import build_parser
from hubodo.effects import EFFECTS
from hubodo.log.convert import write_recording
from hubodo.recording import Recording, Table
from hubodo.verbs import VERBS, completers
from in_process import hubodo
from wanted import program

ROOT = Path(__file__).resolve().parents[2]


class _Ended(Exception):
    pass


@pytest.fixture
def offers(monkeypatch, tmp_path):
    """What is offered at the end of a line, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("_ARGCOMPLETE", "1")
    monkeypatch.setenv("_ARGCOMPLETE_IFS", "\n")

    def ask(line):
        monkeypatch.setenv("COMP_LINE", line)
        monkeypatch.setenv("COMP_POINT", str(len(line)))
        monkeypatch.setenv("_ARGCOMPLETE_COMP_WORDBREAKS", "")
        out = io.TextIOWrapper(io.BytesIO())

        def end(code):
            raise _Ended

        with pytest.raises(_Ended):
            completers.complete(build_parser(completers.typed_words()), output_stream=out, exit_method=end)
        return [word.strip() for word in out.buffer.getvalue().decode().split("\n") if word]

    return ask


def test_verbs_and_the_options_of_the_verb_that_was_named_are_offered(offers):
    assert set(offers("hubodo ")) >= set(VERBS)
    assert offers("hubodo rec") == ["record", "recover"]
    assert {"--vehicle", "--log-format", "--quiet"} <= set(offers("hubodo record --"))
    assert offers("hubodo record --log-format ") == ["text", "json"]
    assert offers("hubodo record --baud ") == []


def test_ports_are_offered_with_their_serial_numbers_and_behind_a_name(offers, monkeypatch):
    devices = [Device("/dev/ttyACM0", "E661"), Device("/dev/ttyS0", None)]
    monkeypatch.setattr(completers, "list_devices", lambda: devices)
    assert set(offers("hubodo record ")) >= {"/dev/ttyACM0", "E661", "/dev/ttyS0", "left="}
    assert offers("hubodo record left=/dev/ttyA") == ["left=/dev/ttyACM0"]
    assert offers("hubodo flash /dev/ttyA") == ["/dev/ttyACM0"]
    assert offers("hubodo record --gnss E") == ["E661"]


def test_files_are_offered_by_what_the_argument_takes(offers, tmp_path):
    for name in ("a.mcap", "v.toml", "notes.txt", ".hidden.mcap"):
        (tmp_path / name).touch()
    (tmp_path / "rides").mkdir()
    (tmp_path / "rides" / "b.mcap").touch()
    assert offers("hubodo info ") == ["a.mcap", "rides/"]
    assert offers("hubodo info rides/") == ["rides/b.mcap"]
    assert offers("hubodo info nowhere/") == []
    assert offers("hubodo fuse a.mcap --vehicle ") == ["rides/", "v.toml"]


def test_nodes_are_those_of_the_log_that_was_named(offers, tmp_path):
    table = Table(
        {name: [0.0, 0.1] for name in ("t", "gx", "gy", "gz", "ax", "ay", "az")} | {"t": [0.0, 0.1]}
    )
    write_recording(Recording(nodes={"rear": table, "front": table}), tmp_path / "a.mcap")
    assert offers("hubodo allan a.mcap --node ") == ["front", "rear"]
    assert offers("hubodo fuse a.mcap --nodes front,") == ["front,front", "front,rear"]
    (tmp_path / "csv").mkdir()
    for name in ("hub.csv", "truth.csv", "wheels.csv.gz"):
        (tmp_path / "csv" / name).touch()
    assert offers("hubodo allan csv --node ") == ["hub"]
    (tmp_path / "broken.mcap").write_bytes(b"no log")
    assert "left" in offers("hubodo allan broken.mcap --node ")
    assert set(offers("hubodo gap m.toml a.mcap --accept gyro_b")) == {
        effect.name for effect in EFFECTS if effect.name.startswith("gyro_b")
    }


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_script_is_printed_for_each_shell(shell):
    done = hubodo("completion", shell)
    assert done.code == 0 and "hubodo" in done.out and "_ARGCOMPLETE" in done.out
    assert hubodo("completion", "cmd").code == 2


def test_bash_completes_with_the_script(tmp_path):
    """The script in a real bash, which asks a real `hubodo`."""
    (tmp_path / "ride.mcap").touch()
    (tmp_path / "hubodo").write_text(
        f"#!{sys.executable}\nimport sys\nfrom hubodo.cli import main\nsys.exit(main())\n"
    )
    (tmp_path / "hubodo").chmod(0o755)
    script = """
        eval "$(hubodo completion bash)"
        COMP_LINE="hubodo info r"; COMP_POINT=${#COMP_LINE}; COMP_WORDS=(hubodo info r); COMP_CWORD=2
        _python_argcomplete hubodo; echo "${COMPREPLY[@]}"
    """
    path = f"{tmp_path}:{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}"}
    command = [program("bash"), "-c", script]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["ride.mcap"], done.stderr
