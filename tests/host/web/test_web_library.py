"""Recordings of a folder and their derived files: reached by name, and no file outside the folder."""

import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
from starlette.testclient import TestClient

from hubodo.log.log_writer import LogWriter
from hubodo.web.address import Address
from hubodo.web.app import make_app
from hubodo.web.config import Site
from hubodo.web.derived_files import DerivedFiles
from hubodo.web.jobs import Job
from hubodo.web.library import RecordingLibrary
from waiting import until

SITE = Site(Address("127.0.0.1", 8642))


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "ride.mcap"
    with LogWriter(path, t_zero_ns=0) as writer:
        t_ns = np.arange(1, 200, dtype=np.int64) * 10_000_000
        writer.write_imu("left", t_ns, t_ns, np.zeros((199, 3)), np.full((199, 3), 9.8))
    return path


@pytest.fixture
def folder(tmp_path, log):
    """Create a folder with two recordings, and files in and beside it that must not be served."""
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
    app = make_app(SITE, RecordingLibrary(folder))
    with TestClient(app, base_url="http://127.0.0.1:8642") as client:
        client.headers["x-hubodo-token"] = app.state.secrets.csrf
        yield client


def run_job(browser, **body):
    """Run a job to its end and return its final state."""
    started = browser.post("/api/jobs", json=body)
    assert started.status_code == 202, started.text
    path = f"/api/jobs/{started.json()['id']}"
    until(lambda: browser.get(path).json()["state"] in ("done", "failed", "cancelled"))
    return browser.get(path).json()


def test_recordings_are_listed_and_downloaded_by_their_names(browser, log):
    answer = browser.get("/api/recordings").json()
    assert {recording["name"] for recording in answer["recordings"]} == {"a.mcap", "may/b ü?.mcap"}
    assert answer["models"] == ["model.toml"]
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
def test_no_name_reaches_a_file_outside_the_folder(browser, name):
    for where in ("/api/recordings", "/api/paths", "/pages/report", "/pages/gap"):
        answer = browser.get(f"{where}/{name}")
        assert answer.status_code in (307, 404) or (name == "" and where == "/api/recordings")
        assert "secret" not in answer.text and "root:" not in answer.text
    assert browser.post("/api/jobs", json={"kind": "info", "name": name}).status_code == 404
    assert browser.get(f"/static/{name}").status_code == 404


@pytest.mark.parametrize("kind", ["odometry", "gnss"])
def test_the_path_of_a_log_covers_it_from_a_bounded_number_of_chunks_and_is_cached(browser, folder, kind):
    turn = np.linspace(0.0, np.pi, 300)  # one chunk each
    position = 100.0 * np.column_stack([np.sin(turn), 1.0 - np.cos(turn)])
    with LogWriter(folder / "half.mcap", t_zero_ns=0) as writer:
        for number, place in enumerate(position):
            t_ns = np.array([(number + 1) * 1_000_000_000])
            if kind == "odometry":
                writer.write_odometry(t_ns, t_ns, place[None], [turn[number]], [1.0], [0.1])
            else:
                degrees = place[1] / 110_574.0, place[0] / 111_320.0  # at the equator
                writer.write_gnss_fix(t_ns, t_ns, [degrees[0]], [degrees[1]], [0.0])
            writer.flush()
    answer = browser.get("/api/paths/half.mcap").json()
    assert answer["topic"] == {"odometry": "/odom", "gnss": "/gnss/fix"}[kind]
    points = np.array(answer["points"])
    assert 80 <= len(points) <= 300
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1] - 100.0), 100.0, atol=0.5)
    assert points[0, 1] < 0.1 and points[-1, 1] > 199.0
    cached = folder / "pages" / "half.mcap" / "path.json"
    cached.write_text(cached.read_text().replace(answer["topic"], "/cached"))
    assert browser.get("/api/paths/half.mcap").json()["topic"] == "/cached"


def test_a_log_without_positions_and_a_file_that_is_no_log_have_no_path(browser, folder):
    (folder / "text.mcap").write_text("no log")
    for name in ("a.mcap", "text.mcap"):
        assert browser.get(f"/api/paths/{name}").json()["points"] == []


def test_a_model_must_be_in_the_folder_and_the_kind_of_job_must_be_known(browser):
    ask = {"name": "a.mcap", "kind": "gap"}
    for model in ("../model.toml", "/etc/hosts", None):
        assert browser.post("/api/jobs", json={**ask, "model": model}).status_code == 404
    assert browser.post("/api/jobs", json={**ask, "kind": "recover"}).status_code == 400


def test_a_report_is_served_while_newer_than_the_recording_and_without_network_access(browser, folder):
    page = folder / "pages" / "a.mcap" / "report.html"
    page.parent.mkdir(parents=True)
    page.write_text("<p>made</p>")
    shown = browser.get("/pages/report/a.mcap")
    assert shown.text == "<p>made</p>"
    assert shown.headers["content-security-policy"].startswith("sandbox allow-scripts")
    assert "connect-src" not in shown.headers["content-security-policy"]
    assert {
        recording["name"]: recording["report"]
        for recording in browser.get("/api/recordings").json()["recordings"]
    } == {
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


def test_a_job_runs_a_verb_and_shows_its_error_line(browser, folder):
    answer = run_job(browser, kind="info", name="a.mcap")
    assert answer["state"] == "done", answer
    assert answer["result"]["streams"][0]["messages"] == 199
    (folder / "a.mcap").write_bytes(b"no log at all")
    answer = run_job(browser, kind="info", name="a.mcap")
    assert answer["state"] == "failed"
    assert "a.mcap" in answer["text"] and "Traceback" not in answer["text"]


def test_progress_is_read_from_the_progress_bar():
    gap_job = Job(1, "gap", "a.mcap", ())
    gap_job.read_output("\x1b[2Kreading a.mcap \x1b[38;5;237m━━━━━━━╸━━━━━\x1b[0m  12%\r")
    assert (gap_job.text, gap_job.progress) == ("reading a.mcap", 0.12)
    gap_job.read_output("\x1b[2Kgoing through candidates ━━━━━━━━━━━━━━")
    gap_job.read_output("╺━━  73%\r")
    assert (gap_job.text, gap_job.progress) == ("going through candidates", 0.73)
    gap_job.finish(2, b"")
    assert gap_job.state == "failed"


def test_results_of_a_job_are_stored_in_pages_and_never_through_a_link(browser, folder):
    victim = folder.parent / "victim"
    victim.mkdir()
    for link in ("pages/a.mcap", "pages"):
        (folder / link).parent.mkdir(exist_ok=True)
        (folder / link).symlink_to(victim)
        assert browser.post("/api/jobs", json={"kind": "report", "name": "a.mcap"}).status_code == 409
        (folder / link).unlink()
        shutil.rmtree(folder / "pages", ignore_errors=True)
    page = folder / "pages" / "a.mcap" / "report.html"
    page.parent.mkdir(parents=True)
    page.symlink_to(victim / "report.html")
    answer = run_job(browser, kind="report", name="a.mcap")
    assert answer["state"] == "done", answer
    assert page.is_file() and not page.is_symlink()
    assert browser.get("/pages/report/a.mcap").text == page.read_text()
    assert list(victim.iterdir()) == []


def test_a_link_that_appears_while_a_job_runs_is_not_followed(tmp_path):
    derived, source, victim = DerivedFiles(tmp_path / "rides"), tmp_path / "scratch", tmp_path / "victim"
    for path in (source, victim, tmp_path / "rides" / "pages"):
        path.mkdir(parents=True)
    (source / "report.html").write_text("report")
    derived.check_folder(("a.mcap", "gap"))
    (tmp_path / "rides" / "pages" / "a.mcap").symlink_to(victim)
    with pytest.raises(OSError):
        derived.publish(("a.mcap", "gap"), source)
    assert list(victim.iterdir()) == []
    (tmp_path / "rides" / "pages" / "a.mcap").unlink()
    derived.publish(("a.mcap", "gap"), source)
    assert derived.read(("a.mcap", "gap", "report.html"), 0.0) == b"report"


def test_names_that_are_not_utf8_are_listed_escaped_and_downloaded_by_that_name(browser, folder, log):
    raw = os.fsencode(folder)
    for name in (b"/caf\xe9.mcap", b"/back\\xe9.mcap", b"/line\n.mcap", b"/caf\xe9.toml"):
        shutil.copy(log, raw + name)
    answer = browser.get("/api/recordings").json()
    listed = {recording["name"] for recording in answer["recordings"]}
    assert {r"caf\xe9.mcap", r"back\\xe9.mcap", r"line\n.mcap", "a.mcap"} <= listed
    assert r"caf\xe9.toml" in answer["models"]
    for name in listed:
        answer = browser.get(f"/api/recordings/{quote(name)}")
        assert answer.status_code == 200 and answer.content == log.read_bytes(), name
    assert run_job(browser, kind="info", name=r"caf\xe9.mcap")["state"] == "done"


@pytest.fixture
def long_job(monkeypatch, tmp_path):
    """Replace the verb by one that never ends and starts a child; return a function for both process ids."""
    id_file = tmp_path / "numbers"
    program = (
        "import os, pathlib, signal, subprocess, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); "
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(1000)']); "
        f"pathlib.Path({str(id_file)!r}).write_text(f'{{os.getpid()}} {{child.pid}}\\n'); time.sleep(1000)"
    )
    script = tmp_path / "verb"
    script.write_text(f"#!{sys.executable}\n{program}\n")
    script.chmod(0o700)
    monkeypatch.setattr("hubodo.web.jobs.sys.executable", str(script))

    def process_ids():
        until(lambda: id_file.is_file() and id_file.read_text().endswith("\n"))
        return [int(number) for number in id_file.read_text().split()]

    return process_ids


def is_running(process_id):
    try:
        return Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_cancelled_job_ends_with_its_child_processes(browser, long_job):
    first = browser.post("/api/jobs", json={"kind": "info", "name": "a.mcap"}).json()
    second = browser.post("/api/jobs", json={"kind": "report", "name": "a.mcap"}).json()
    process_ids = long_job()
    assert first["limit"] == 3600 and all(map(is_running, process_ids))
    for started in (second, first):
        answer = browser.post(f"/api/jobs/{started['id']}/cancel", json={})
        assert answer.status_code == 202 and answer.json()["state"] == "cancelled"
    until(lambda: not any(map(is_running, process_ids)))
    assert browser.post("/api/jobs/99/cancel", json={}).status_code == 404
    assert browser.get(f"/api/jobs/{first['id']}").json()["text"] == "cancelled"


def test_a_job_is_stopped_at_its_time_limit_and_reports_it(folder, long_job):
    # On a busy computer a job, which has a low priority, takes two seconds to start its child.
    app = make_app(replace(SITE, job_limit=4.0), RecordingLibrary(folder))
    with TestClient(app, base_url="http://127.0.0.1:8642") as browser:
        browser.headers["x-hubodo-token"] = app.state.secrets.csrf
        answer = run_job(browser, kind="info", name="a.mcap")
    assert answer["state"] == "failed" and "time limit ([web] job_limit)" in answer["text"]
    assert not any(map(is_running, long_job()))
