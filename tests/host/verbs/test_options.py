"""Options are spelled with hyphens in every `--help` and accepted with underscores too."""

import argparse
import re
import subprocess
import sys
from pathlib import Path

import pytest

from hubodo.cli import build_parser, main
from hubodo.verbs import VERBS


def long_help(arguments, capsys) -> str:
    assert main([*arguments, "--help"]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments", [[verb] for verb in VERBS] + [["calibrate", "imu"], ["calibrate", "wheels"]]
)
def test_help_has_an_example_and_spells_options_with_hyphens(arguments, capsys):
    text = long_help(arguments, capsys)
    assert f"hubodo {arguments[0]}" in text.split("example:")[-1]
    # File names and JSON keys have underscores; options have none.
    assert not re.findall(r"--[a-z]+(?:-[a-z]+)*_\w*", text)


def test_the_list_of_verbs_loads_none_of_them():
    program = "import sys; from hubodo.cli import main; main(['--help']); print('numpy' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert all(f"    {verb}" in out for verb in VERBS)
    assert out.splitlines()[-1] == "False"


@pytest.mark.parametrize("option", ["--latitude-deg", "--latitude_deg"])
@pytest.mark.parametrize("separator", [" ", "="])
def test_an_option_is_accepted_in_both_spellings(option, separator, tmp_path, capsys):
    arguments = f"north {tmp_path / 'under_score'} --node left_1 {option}{separator}95 --json".split(" ")
    assert main(arguments) == 2
    # The error is about the latitude, so the option was read; the name of the folder keeps its underscore.
    assert "latitude 95 degrees is out of range" in capsys.readouterr().err


def test_values_keep_their_underscores(tmp_path, capsys):
    log = tmp_path / "log_1"
    log.mkdir()
    (log / "left_1.csv").write_text("t,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n0.01,0,0,0,0,0,9.8\n")
    assert main(["north", str(log), "--node", "left_2", "--latitude_deg", "48"]) == 2
    assert "'left_2'; it has left_1" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["calibrate", "imu", "--json"], ["calibrate", "--json", "imu"]])
def test_json_is_accepted_before_and_after_the_kind_of_calibration(arguments, tmp_path, capsys):
    log = str(tmp_path / "none")
    assert main([*arguments, log, "--node", "frame", "-o", str(tmp_path / "c.toml")]) == 2
    assert "unrecognized" not in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [[verb] for verb in VERBS if verb != "calibrate"])
def test_no_numeric_option_accepts_nan_or_infinity(arguments):
    """Texts that are not numbers, and implausible numbers, are refused by the parser of every option."""
    parser = build_parser(arguments)
    command = next(a for a in parser._actions if a.dest == "verb").choices[arguments[0]]
    for action in command._actions:
        if action.type is None or action.type is Path:
            continue
        for text in ("nan", "inf", "-inf", "1e308", "x", ""):
            with pytest.raises((argparse.ArgumentTypeError, ValueError)):
                action.type(text)
