"""Errors of the command line."""

import pytest

from hubodo.verbs.parser import EXIT_REFUSED, Parser, UsageError


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
