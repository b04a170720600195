"""One spelling of options in every `--help`, both spellings on the command line."""

import argparse
import re
import subprocess
import sys
from pathlib import Path

import pytest

from hubodo.cli import build_parser, main
from hubodo.verbs import VERBS


def long_help(words, capsys) -> str:
    assert main([*words, "--help"]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize(
    "words", [[verb] for verb in VERBS] + [["calibrate", "imu"], ["calibrate", "wheels"]]
)
def test_help_has_an_example_and_spells_options_with_hyphens(words, capsys):
    text = long_help(words, capsys)
    assert f"hubodo {words[0]}" in text.split("example:")[-1]
    # File names and keys of JSON have underscores; what begins with two hyphens has none.
    assert not re.findall(r"--[a-z]+(?:-[a-z]+)*_\w*", text)


def test_the_list_of_verbs_waits_for_none_of_them():
    seen = "import sys; from hubodo.cli import main; main(['--help']); print('numpy' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", seen], capture_output=True, text=True, check=True).stdout
    assert all(f"    {verb}" in out for verb in VERBS)
    assert out.splitlines()[-1] == "False"


@pytest.mark.parametrize("option", ["--latitude-deg", "--latitude_deg"])
@pytest.mark.parametrize("glue", [" ", "="])
def test_an_option_is_taken_in_both_spellings(option, glue, tmp_path, capsys):
    words = f"north {tmp_path / 'under_score'} --node left_1 {option}{glue}95 --json".split(" ")
    assert main(words) == 2
    # The latitude was read; the folder's name keeps its underscore.
    assert "latitude 95 degrees is out of range" in capsys.readouterr().err


def test_values_keep_their_underscores(tmp_path, capsys):
    log = tmp_path / "log_1"
    log.mkdir()
    (log / "left_1.csv").write_text("t,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n0.01,0,0,0,0,0,9.8\n")
    assert main(["north", str(log), "--node", "left_2", "--latitude_deg", "48"]) == 2
    assert "'left_2'; it has left_1" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["calibrate", "imu", "--json"], ["calibrate", "--json", "imu"]])
def test_json_is_taken_before_and_behind_the_kind_of_calibration(words, tmp_path, capsys):
    log = str(tmp_path / "none")
    assert main([*words, log, "--node", "frame", "-o", str(tmp_path / "c.toml")]) == 2
    assert "unrecognized" not in capsys.readouterr().err


@pytest.mark.parametrize("words", [[verb] for verb in VERBS if verb != "calibrate"])
def test_no_option_that_takes_a_number_takes_nan_or_infinity(words):
    """The parser's own table: what is no number, or none that can be meant, is no value of any option."""
    parser = build_parser(words)
    command = next(a for a in parser._actions if a.dest == "verb").choices[words[0]]
    for action in command._actions:
        if action.type is None or action.type is Path:
            continue
        for text in ("nan", "inf", "-inf", "1e308", "x", ""):
            with pytest.raises((argparse.ArgumentTypeError, ValueError)):
                action.type(text)
