"""Texts and numbers of users and files are escaped for terminals, pages and JSON."""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.table import Table as RichTable

import hubodo.safe_text
from fuzz.seeds import T0
from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.log.log_writer import LogWriter
from hubodo.recording import Event
from hubodo.safe_text import json_text, printable
from hubodo.terminal import SafeConsole
from in_process import hubodo as run

PACKAGE = Path(hubodo.safe_text.__file__).parent
HOSTILE = "bad \ud800 \x1b[2J\x1b]0;owned\x07 mark"


def parse_strict_json(text: str) -> Any:
    """Parse JSON, refusing NaN, infinity and lone surrogates."""

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    value = json.loads(text, parse_constant=refuse)
    json.dumps(value, ensure_ascii=False).encode()
    return value


def test_json_has_null_for_numbers_that_are_not_finite_and_no_lone_surrogates() -> None:
    value = {
        "a": [float("nan"), np.float64("inf"), np.float32(0.5), -np.inf, 1],
        "b": {"x": np.array([1.0, np.nan]), "p": Path("log.mcap"), "n": np.int64(3), "t": (True, None)},
        HOSTILE: HOSTILE,
    }
    assert parse_strict_json(json_text(value, ascii_only=False)) == {
        "a": [None, None, 0.5, None, 1],
        "b": {"x": [1.0, None], "p": "log.mcap", "n": 3, "t": [True, None]},
        HOSTILE.replace("\ud800", "\\ud800"): HOSTILE.replace("\ud800", "\\ud800"),
    }


def test_one_function_of_the_package_writes_json() -> None:
    # The journal of a search is read only by this program and stores every number exactly; the text of a ROS
    # 2 type is hashed, so it has the spaces that ROS gives it.
    allowed = {"safe_text.py", "gap/judge/journal.py", "ros2/type_hash.py"}
    writing = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if "json.dump" in path.read_text("utf-8")
    }
    assert writing == allowed


def test_control_characters_and_overrides_are_escaped_and_letters_unchanged() -> None:
    assert printable("rad/s² → é\t1\n") == "rad/s² → é\t1\n"
    assert printable(HOSTILE) == r"bad \ud800 \x1b[2J\x1b]0;owned\x07 mark"
    assert printable("\u202e\x9b") == r"\u202e\x9b"
    assert str(InputError(f"x: {HOSTILE}")) == r"x: bad \ud800 \x1b[2J\x1b]0;owned\x07 mark"
    assert len(str(InputError("x" * 1_000_000))) < 3000


def test_printed_texts_contain_no_terminal_control_codes() -> None:
    out = io.StringIO()
    console = SafeConsole(file=out, width=100)
    table = RichTable("column")
    table.add_row(HOSTILE)
    console.print(HOSTILE, table, markup=False)
    assert "\x1b" not in out.getvalue()
    assert out.getvalue().count(r"\x1b[2J") == 2


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """Write a log of a gyro ramp with a hostile mark that is not escaped."""
    path = tmp_path_factory.mktemp("marked") / "log.mcap"
    event = Event(T0 + 5, "mark", "user", "x", {"note": HOSTILE, "value": float("nan")})
    object.__setattr__(event, "text", HOSTILE)
    t = T0 + np.arange(2000) * 10_000_000
    with LogWriter(path, t_zero_ns=T0, clock=None) as writer:
        writer.write_event(event)
        writer.write_imu("left", t, t, np.outer(np.arange(2000), np.full(3, 1e-6)), np.full((2000, 3), 3.0))
    return path


def test_a_mark_is_stored_escaped() -> None:
    event = Event(0, "mark", "user", HOSTILE)
    assert event.text == printable(HOSTILE)
    event.text.encode()


@pytest.mark.parametrize(
    "command",
    [
        ("info", "LOG"),
        ("allan", "LOG", "--node", "left", "--channel", "gz", "--as-is"),
        ("allan", "LOG", "--node", "left", "--channel", "gz"),
        ("heading", "LOG", "--node", "left", "--axis", "z"),
        ("report", "LOG", "-o", "OUT/page.html"),
        ("export", "LOG", "-o", "OUT/folder"),
        ("recover", "LOG", "-o", "OUT/whole.mcap"),
    ],
)
def test_each_verb_survives_a_hostile_mark_and_its_json_is_valid(log, tmp_path, command) -> None:
    for options in (("--json",), ()):
        out = tmp_path / f"out{len(options)}"
        out.mkdir()
        done = run(
            *(argument.replace("LOG", str(log)).replace("OUT", str(out)) for argument in command), *options
        )
        assert done.code in (0, 2)
        assert "defect" not in done.err
        assert "\x1b" not in done.out + done.err
        (done.out + done.err).encode()
        if options and done.code == 0:
            parse_strict_json(done.out)


def test_events_of_a_log_are_escaped_when_they_are_read(log) -> None:
    (mark,) = [event for event in read_log(log).events if event.kind == "mark"]
    assert mark.text == printable(HOSTILE)
