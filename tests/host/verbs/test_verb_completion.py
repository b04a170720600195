"""Shell completion of `hubodo` commands: verbs, options, ports, files and nodes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from hubodo.effects import EFFECTS
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table
from hubodo.verbs import VERBS
from in_process import hubodo
from wanted import program

ROOT = Path(__file__).resolve().parents[3]


COMPLETE_LINES = """
import io, json, os, sys
from types import SimpleNamespace
from hubodo.cli import build_parser
from hubodo.verbs import completers

class Ended(Exception):
    pass

def end(code):
    raise Ended

ports = [SimpleNamespace(device="/dev/ttyACM0", serial_number="E661")]
ports += [SimpleNamespace(device="/dev/ttyS0", serial_number=None)]
completers.list_devices = lambda: ports
os.environ.update(_ARGCOMPLETE="1", _ARGCOMPLETE_IFS="\\n", _ARGCOMPLETE_COMP_WORDBREAKS="")
offers = {}
for line in json.loads(sys.argv[1]):
    os.environ.update(COMP_LINE=line, COMP_POINT=str(len(line)))
    out = io.TextIOWrapper(io.BytesIO())
    try:
        parser = build_parser(completers.typed_words())
        completers.complete_command(parser, output_stream=out, exit_method=end)
    except Ended:
        offers[line] = [word.strip() for word in out.buffer.getvalue().decode().split("\\n") if word]
print(json.dumps(offers))
"""
ENVIRONMENT = {**os.environ, "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}"}


VERB_LINES = (
    "hubodo ",
    "hubodo rec",
    "hubodo record --",
    "hubodo record --log-format ",
    "hubodo record --baud ",
)
PORT_LINES = (
    "hubodo record ",
    "hubodo record left=/dev/ttyA",
    "hubodo flash /dev/ttyA",
    "hubodo record --gnss E",
)
FILE_LINES = ("hubodo info ", "hubodo info rides/b", "hubodo info nowhere/", "hubodo fuse a.mcap --vehicle ")
NODE_LINES = (
    "hubodo allan a.mcap --node ",
    "hubodo fuse a.mcap --nodes front,",
    "hubodo allan csv --node ",
    "hubodo allan rides/broken.mcap --node ",
    "hubodo gap m.toml a.mcap --accept gyro_b",
)


@pytest.fixture(scope="module")
def offers(tmp_path_factory):
    """Return the completions at the end of each line, in a folder with logs, computed in one process."""
    folder = tmp_path_factory.mktemp("completion")
    table = Table({name: [0.0, 0.1] for name in ("t", "gx", "gy", "gz", "ax", "ay", "az")})
    write_recording(Recording(nodes={"rear": table, "front": table}), folder / "a.mcap")
    for name in ("v.toml", "notes.txt", ".hidden.mcap", "rides/b.mcap", "csv/hub.csv", "csv/truth.csv"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).touch()
    (folder / "csv" / "wheels.csv.gz").touch()
    (folder / "rides" / "broken.mcap").write_bytes(b"no log")
    lines = json.dumps([*VERB_LINES, *PORT_LINES, *FILE_LINES, *NODE_LINES])
    command = [sys.executable, "-c", COMPLETE_LINES, lines]
    done = subprocess.run(command, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_verbs_and_options_are_offered(offers):
    verbs, begun, options, formats, numbers = (offers[line] for line in VERB_LINES)
    assert set(verbs) >= set(VERBS) and begun == ["record", "recover"]
    assert {"--vehicle", "--log-format", "--quiet"} <= set(options)
    assert formats == ["text", "json"] and numbers == []


def test_ports_are_offered(offers):
    ports, named, flash, gnss = (offers[line] for line in PORT_LINES)
    assert set(ports) >= {"/dev/ttyACM0", "E661", "/dev/ttyS0", "left="}
    assert (named, flash, gnss) == (["left=/dev/ttyACM0"], ["/dev/ttyACM0"], ["E661"])


def test_files_are_offered(offers):
    logs, inside, nowhere, tables = (offers[line] for line in FILE_LINES)
    assert (logs, inside) == (["a.mcap", "csv/", "rides/"], ["rides/b.mcap", "rides/broken.mcap"])
    assert (nowhere, tables) == ([], ["csv/", "rides/", "v.toml"])


def test_the_nodes_of_the_given_log_are_offered(offers):
    node, nodes, csv, broken, effects = (offers[line] for line in NODE_LINES)
    assert (node, nodes, csv) == (["front", "rear"], ["front,front", "front,rear"], ["hub"])
    assert "left" in broken
    assert set(effects) == {effect.name for effect in EFFECTS if effect.name.startswith("gyro_b")}


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_script_is_printed_for_each_shell(shell):
    done = hubodo("completion", shell)
    assert done.code == 0 and "hubodo" in done.out and "_ARGCOMPLETE" in done.out
    assert hubodo("completion", "cmd").code == 2


def test_bash_completes_with_the_script(tmp_path):
    """Load the script in a real bash, which calls a real `hubodo`."""
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
    environment = {**ENVIRONMENT, "PATH": path}
    command = [program("bash"), "-c", script]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["ride.mcap"], done.stderr
