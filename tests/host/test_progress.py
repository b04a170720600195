"""Progress of a long verb, on a terminal only."""

import io

import pytest

from hubodo import progress


class Terminal(io.StringIO):
    """Standard error of a process in a terminal."""

    def isatty(self) -> bool:
        return True


def test_without_a_terminal_nothing_is_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()
    monkeypatch.setattr("sys.stderr", stream)
    with progress.progress_line() as show:
        show("reading", 0.5)
    assert stream.getvalue() == ""


def test_on_a_terminal_the_line_shows_text_and_share(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Terminal()
    monkeypatch.setattr("sys.stderr", stream)
    for name in ("NO_COLOR", "TERM"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("COLUMNS", "80")
    with progress.progress_line() as show:
        show("reading drive.mcap", 0.25)
        show("reading drive.mcap", 0.75)
    assert "reading drive.mcap" in stream.getvalue() and "75%" in stream.getvalue()
