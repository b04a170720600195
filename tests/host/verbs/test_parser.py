"""Errors of the command line."""

from pathlib import Path

import pytest

from hubodo.verbs.parser import EXIT_REFUSED, Parser, UsageError
from hubodo.version import __version__
from in_process import hubodo


def test_an_invalid_command_line_is_one_line_with_a_hint_and_exit_code_2(
    capsys: pytest.CaptureFixture[str],
) -> None:
    parser = Parser(prog="hubodo fuse")
    parser.add_argument("log")
    parser.add_argument("--rate", type=float)
    for words in (["--rate", "a\nb", "log"], [], ["log", "--unknown"]):
        with pytest.raises(UsageError) as error:
            parser.parse_args(words)
        assert error.value.code == EXIT_REFUSED == 2
        assert error.value.text.startswith("hubodo fuse: ")
        assert error.value.text.endswith("; see hubodo fuse --help")
        assert "\n" not in error.value.text
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("infoo", "did you mean 'info'"),
        ("allan night.mcap --axis x", "write --channel gx"),
        ("allan --axis x", "write --channel gx"),
        ("fuse vehicle.toml drive.mcap -o out", "write drive.mcap --vehicle vehicle.toml"),
        ("calibrate wheels drive.mcap --vehicel v.toml -o c.toml", "did you mean '--vehicle'"),
        ("simulate model.toml --drive tabel -o a.mcap", "unknown 'tabel', did you mean 'turntable'"),
        ("simulate model.toml --drive circles -o a.mcap", "unknown 'circles'; choose from random,"),
        ("info drive.mcap /", "one log at a time: `hubodo batch` takes several"),
        ("-v", "write --version"),
        ("info drive.mcap --verbose", "write --debug"),
        ("fuse drive.mcap -o out --start 3", "unknown option --start; see"),
        ("allan night.mcap -o allan.html", "write --report allan.html"),
        ("serve . --port 8000", "write --at 127.0.0.1:8000"),
        ("demo --seconds 10", "write --moving 10"),
        ("node info /dev/ttyACM0", "check the order of the arguments"),
        ("node /dev/ttyACM0", "required: ACTION; choose from "),
        ("track out/", "unknown 'track', write fuse; see"),
        ("fuse drive.mcap -o out --format gpx", "unknown option --format; see"),
        ("fuse drive.mcap -o out --wheel-radius 0.3", "`hubodo vehicle new` writes it, --vehicle names it"),
        ("vehicle new --wheel 26in", "write --diameter 26in"),
        ("record --sim", "`hubodo demo` records virtual nodes"),
        ("flash --list", "unknown option --list; see"),
        ("vehicle", "required: KIND; choose from new, check; see"),
        ("convert drive.ulg", "unknown 'convert', write import or export"),
        ("view drive.mcap", "write report or serve"),
        ("fuse drive.mcap vehicle.toml -o out", "'vehicle.toml', write --vehicle vehicle.toml"),
        ("fuse -v vehicle.toml drive.mcap -o out", "write --vehicle TOML"),
        ("allan night.csv -r 100", "write --rate 100"),
        ("sheet night.mcap -o sheet", "'night.mcap', write --still night.mcap or --warmup night.mcap"),
        ("play drive.mcap --web", "unknown option --web; see"),
        ("import left.csv right.csv -o a.mcap", "`hubodo import FOLDER` joins one drive"),
        ("report drive.mcap -o report.pdf", "report.pdf: a page is HTML; name a file that ends in .html"),
        (
            "export drive.mcap -o track.csv",
            "one for each node; name a folder, add --format rosbag2",
        ),
        ("record udp://127.0.0.1:1 --duration 1m", "write a number above 0, without a unit"),
    ],
)
def test_an_unknown_word_is_answered_by_what_was_meant(words: str, text: str) -> None:
    done = hubodo(*words.split())
    assert (done.code, done.out, text in done.err) == (EXIT_REFUSED, "", True), done.err
    assert done.err.count("\n") == 1


def test_an_empty_path_is_refused_instead_of_meaning_the_current_folder() -> None:
    for words in (("info", ""), ("fuse", "drive.mcap", "-o", "")):
        done = hubodo(*words)
        assert (done.code, done.out) == (EXIT_REFUSED, "")
        assert "is empty; name a file or folder" in done.err


@pytest.mark.parametrize("words", ["", "help", "help fuse", "-V", "version"])
def test_help_and_version_are_given_in_every_way_that_people_ask(words: str) -> None:
    done = hubodo(*words.split())
    assert (done.code, done.err) == (0, "")
    assert "usage: hubodo" in done.out or done.out == f"hubodo {__version__}\n"


@pytest.mark.parametrize("words", [("47,-8.5",), ("47 -8.5",), ("47", "-8.5")])
def test_a_pair_of_values_may_be_one_word(words: tuple[str, ...]) -> None:
    parser = Parser()
    parser.add_argument("--origin", nargs=2, type=float)
    parser.add_argument("log")
    args = parser.parse_args(["--origin", *words, "a,b"])
    assert (args.origin, args.log) == ([47.0, -8.5], "a,b")


def test_an_output_inside_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "drive.mcap").write_bytes(b"")
    done = hubodo("example", tmp_path / "drive.mcap" / "x")
    assert done.code == EXIT_REFUSED and "is a file, not a folder" in done.err
