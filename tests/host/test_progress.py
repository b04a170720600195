"""Progress of a long verb: a bar on a terminal, else a line every ten seconds."""

import io

import pytest

from hubodo import progress


class Terminal(io.StringIO):
    """Standard error of a process in a terminal."""

    def isatty(self) -> bool:
        return True


def test_in_a_pipe_a_line_is_printed_every_ten_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    stream, now = io.StringIO(), [0.0]
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with progress.progress_line() as show:
        for second in range(25):
            now[0] = float(second)
            show(f"round {second}", second / 25.0)
    assert stream.getvalue() == " 40 %  round 10\n 80 %  round 20\n"


def test_a_short_verb_prints_nothing_in_a_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
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
