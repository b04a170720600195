"""Every line on stderr is a JSON object, also those of libraries; else plain lines."""

import gc
import json
import logging
import threading
import urllib.request
import warnings

import pytest

from fakes.fake_node import FakeNode
from hubodo.ingest.live.program_log import program_log
from hubodo.ingest.live.virtual_computer import VirtualComputer
from in_process import hubodo

KEYS = {"time", "level", "event", "text", "fields"}


def everything_that_libraries_say():
    """Emit log records with an exception and of asyncio, a warning, exceptions of a thread and an object."""
    try:
        raise RuntimeError("two\nlines")
    except RuntimeError:
        logging.getLogger("uvicorn.error").exception("Exception in ASGI application\n")
    logging.getLogger("asyncio").error("socket.accept() out of system resource\nsocket: %s", "x")
    logging.getLogger("uvicorn.error").info("Started server process")
    warnings.warn("old\nthing", DeprecationWarning, stacklevel=1)
    thread = threading.Thread(target=lambda: 1 / 0)
    thread.start()
    thread.join()

    class Broken:
        def __del__(self):
            raise ValueError("at the end")

    Broken()
    gc.collect()


@pytest.mark.parametrize("log_format", ["json", "text"])
def test_each_message_of_a_library_is_one_line(capsys, log_format, recwarn):
    before = threading.excepthook
    with warnings.catch_warnings(), program_log("record", log_format):
        warnings.simplefilter("always")
        everything_that_libraries_say()
    assert threading.excepthook is before
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 5
    if log_format == "text":
        assert all(line.startswith("hubodo record: ") for line in lines)
        assert "Traceback" not in "".join(lines)
        texts = lines
    else:
        entries = [json.loads(line) for line in lines]
        assert all(set(line) == KEYS for line in entries)
        assert [line["level"] for line in entries] == ["error", "error", "warning", "error", "error"]
        assert "Traceback" in entries[0]["fields"]["traceback"]
        texts = [line["text"] for line in entries]
    says = (
        "RuntimeError: two lines",
        "accept",
        "DeprecationWarning: old thing",
        "ZeroDivision",
        "at the end",
    )
    assert all(word in text for word, text in zip(says, texts, strict=True))


def test_a_recording_with_the_page_reports_its_end_and_server_errors_in_json(tmp_path, monkeypatch):
    """The format set in hubodo.toml applies too, also with --debug."""

    def broken(self, request):
        raise RuntimeError("no such thing")

    def ask(url):
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(url, timeout=60)

    monkeypatch.setattr("hubodo.web.app.RequestHandlers._index", broken)
    asked = []

    def record(*args, **named):
        for greeting in named["audience"].startup_lines:
            ask(greeting.rpartition(" ")[2])
            asked.append(greeting)
        return real(*args, **named)

    import hubodo.ingest.live.daemon as daemon

    real = daemon.record
    monkeypatch.setattr(daemon, "record", record)
    config = tmp_path / "hubodo.toml"
    config.write_text('[record]\nlog_format = "json"\n[web]\nlisten = "127.0.0.1:0"\n')
    computer = VirtualComputer()
    with FakeNode(computer=computer) as node:
        words = ("record", node.path, "--config", config, "--duration", 1, "--debug", "-o")
        done = hubodo(*words, tmp_path / "a.mcap", computer=computer)
        again = hubodo(*words, tmp_path / "a.mcap", computer=computer)
    assert (done.code, again.code) == (0, 2) and asked
    entries = [json.loads(line) for line in (done.err + again.err).splitlines()]
    assert all(set(line) == KEYS for line in entries)
    error = next(line for line in entries if line["event"] == "program")
    assert error["text"].endswith("RuntimeError: no such thing")
    assert entries[-1]["event"] == "failed" and "exists already" in entries[-1]["text"]
    assert entries[-1]["fields"]["exit_code"] == 2 and "Traceback" in entries[-1]["fields"]["traceback"]


@pytest.mark.parametrize("words", [("--log-format", "json"), ("--log_format=json",)])
def test_a_refused_command_line_is_reported_in_json_too(words):
    done = hubodo("record", "port", "--duration", "nan", *words)
    assert done.code == 2
    entries = json.loads(done.err)
    assert (
        entries["event"] == "failed"
        and "--duration" in entries["text"]
        and entries["fields"] == {"exit_code": 2}
    )
    plain = hubodo("record", "port", "--duration", "nan")
    assert plain.code == 2 and plain.err.startswith("hubodo record: argument --duration")
