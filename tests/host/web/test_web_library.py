"""The recordings of a folder and what is made of them: found by name, and nothing outside by any name."""

import os
import shutil

import numpy as np
import pytest
from starlette.testclient import TestClient

from hubodo.log.writer import McapLog
from hubodo.web.address import Address
from hubodo.web.app import make_app
from hubodo.web.config import Site
from hubodo.web.jobs import Job
from hubodo.web.library import Library
from waiting import until

SITE = Site(Address("127.0.0.1", 8642))


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "ride.mcap"
    with McapLog(path, t_zero_ns=0) as made:
        t_ns = np.arange(1, 200, dtype=np.int64) * 10_000_000
        made.imu("left", t_ns, t_ns, np.zeros((199, 3)), np.full((199, 3), 9.8))
    return path


@pytest.fixture
def folder(tmp_path, log):
    """A folder with two recordings, and beside it what is nobody's business."""
    (tmp_path / "secret.mcap").write_text("secret")
    inside = tmp_path / "rides"
    (inside / "may").mkdir(parents=True)
    shutil.copy(log, inside / "a.mcap")
    shutil.copy(log, inside / "may" / "b ü?.mcap")
    (inside / "model.toml").write_text("")
    (inside / "notes.txt").write_text("secret")
    (inside / ".hidden.mcap").write_text("secret")
    (inside / "link.mcap").symlink_to(tmp_path / "secret.mcap")
    (inside / "out").symlink_to(tmp_path)
    return inside


@pytest.fixture
def browser(folder):
    app = make_app(SITE, Library(folder))
    with TestClient(app, base_url="http://127.0.0.1:8642") as made:
        made.headers["x-hubodo-token"] = app.state.secrets.csrf
        yield made


def job(browser, **asked):
    """Runs it to its end."""
    started = browser.post("/api/jobs", json=asked)
    assert started.status_code == 202, started.text
    path = f"/api/jobs/{started.json()['id']}"
    until(lambda: browser.get(path).json()["state"] in ("done", "failed"))
    return browser.get(path).json()


def test_recordings_are_listed_and_downloaded_by_their_names(browser, log):
    told = browser.get("/api/recordings").json()
    assert {one["name"] for one in told["recordings"]} == {"a.mcap", "may/b ü?.mcap"}
    assert told["models"] == ["model.toml"]
    for name in ("a.mcap", "may/b%20%C3%BC%3F.mcap"):
        assert browser.get(f"/api/recordings/{name}").content == log.read_bytes()


@pytest.mark.parametrize(
    "name",
    [
        *("../secret.mcap", "..%2fsecret.mcap", "%2e%2e/secret.mcap", "%252e%252e/secret.mcap"),
        *("/etc/passwd", "%2fetc%2fpasswd", "may/../../secret.mcap", "..\\secret.mcap", "link.mcap"),
        *("out/secret.mcap", ".hidden.mcap", "notes.txt", "model.toml", "a.mcap%00", "", "may", "pages"),
    ],
)
def test_no_name_leads_out_of_the_folder(browser, name):
    for where in ("/api/recordings", "/pages/report", "/pages/gap"):
        answer = browser.get(f"{where}/{name}")
        assert answer.status_code in (307, 404) or (name == "" and where == "/api/recordings")
        assert "secret" not in answer.text and "root:" not in answer.text
    assert browser.post("/api/jobs", json={"kind": "info", "name": name}).status_code == 404
    assert browser.get(f"/static/{name}").status_code == 404


def test_a_model_is_one_of_the_folder_and_a_kind_one_of_three(browser):
    ask = {"name": "a.mcap", "kind": "gap"}
    for model in ("../model.toml", "/etc/hosts", None):
        assert browser.post("/api/jobs", json={**ask, "model": model}).status_code == 404
    assert browser.post("/api/jobs", json={**ask, "kind": "recover"}).status_code == 400


def test_what_was_made_is_shown_while_it_is_newer_than_the_recording_and_can_ask_for_nothing(browser, folder):
    page = folder / "pages" / "a.mcap" / "report.html"
    page.parent.mkdir(parents=True)
    page.write_text("<p>made</p>")
    shown = browser.get("/pages/report/a.mcap")
    assert shown.text == "<p>made</p>"
    assert shown.headers["content-security-policy"].startswith("sandbox allow-scripts")
    assert "connect-src" not in shown.headers["content-security-policy"]
    assert {one["name"]: one["report"] for one in browser.get("/api/recordings").json()["recordings"]} == {
        "a.mcap": True,
        "may/b ü?.mcap": False,
    }
    os.utime(page, (1, 1))
    assert browser.get("/pages/report/a.mcap").status_code == 404
    page.unlink()
    page.symlink_to(folder.parent / "secret.mcap")
    assert browser.get("/pages/report/a.mcap").status_code == 404
    shutil.rmtree(page.parent)
    page.parent.symlink_to(folder.parent)
    (folder.parent / "report.html").write_text("secret")
    assert browser.get("/pages/report/a.mcap").status_code == 404


def test_a_verb_runs_at_a_visitors_wish_and_its_failure_is_told_in_its_own_line(browser, folder):
    told = job(browser, kind="info", name="a.mcap")
    assert told["state"] == "done", told
    assert told["result"]["streams"][0]["messages"] == 199
    (folder / "a.mcap").write_bytes(b"no log at all")
    told = job(browser, kind="info", name="a.mcap")
    assert told["state"] == "failed"
    assert "a.mcap" in told["text"] and "Traceback" not in told["text"]


def test_progress_is_read_from_what_people_would_see():
    going = Job(1, "gap", "a.mcap", ())
    going.heard("\x1b[2Kreading a.mcap \x1b[38;5;237m━━━━━━━╸━━━━━\x1b[0m  12%\r")
    assert (going.text, going.progress) == ("reading a.mcap", 0.12)
    going.heard("\x1b[2Kgoing through candidates ━━━━━━━━━━━━━━")
    going.heard("╺━━  73%\r")
    assert (going.text, going.progress) == ("going through candidates", 0.73)
    going.end(2, b"")
    assert going.state == "failed"
