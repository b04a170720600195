"""`hubodo serve` in a real browser: login, `gap` on a click, and https."""

import ssl
import subprocess
import time
import urllib.request

import pytest

import wanted
from browser_page import Page
from hubodo.errors import InputError
from hubodo.web.address import Address
from hubodo.web.app import make_app
from hubodo.web.config import Site
from hubodo.web.library import RecordingLibrary
from hubodo.web.server import serve_in_thread
from in_process import hubodo
from vehicles import DRIVE_MODEL, LOW_INPUT_NOISE
from waiting import until

pytestmark = pytest.mark.real_time
TOKEN = "correct-horse-battery"
MODEL = DRIVE_MODEL + LOW_INPUT_NOISE


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Create a model and a recording with an effect that it lacks: a cambered wheel."""
    rides = tmp_path_factory.mktemp("rides")
    (rides / "model.toml").write_text(MODEL)
    leaning = tmp_path_factory.mktemp("truth") / "leaning.toml"
    leaning.write_text(MODEL + "[nodes.right.effects.wheel_camber]\nangle = 0.1\n")
    done = hubodo("simulate", leaning, "--duration", 24, "--rate", 52, "-o", rides / "ride.mcap")
    assert done.code == 0, done.err
    return rides


def test_after_login_gap_runs_on_a_click_with_progress_and_its_page_opens(folder, tmp_path):
    site = Site(Address("127.0.0.1", 0), TOKEN)
    with (
        serve_in_thread(make_app(site, RecordingLibrary(folder)), site) as port,
        Page(f"http://127.0.0.1:{port}/", tmp_path / "profile") as page,
    ):
        page.open()
        assert page.run("return location.pathname") == "/login"
        assert page.call_in_page("lowContrastTexts()") == []
        page.save_screenshot("login")
        page.run(f"document.getElementById('token').value = '{TOKEN}'; document.forms[0].submit()")
        until(lambda: page.run("return document.querySelectorAll('.recording').length") == 1)
        assert page.run("return document.getElementById('view-live').hidden")
        until(lambda: page.run("return document.querySelector('.thumbnail polyline')"))
        page.run(
            "const order = document.querySelector('select'); order.value = 'size';"
            "order.dispatchEvent(new Event('change'))"
        )
        assert page.run("return document.querySelector('select').value") == "size"
        assert page.run("return document.querySelectorAll('.recording').length") == 1
        page.run(
            "[...document.querySelectorAll('.recording button')].find((b) => b.innerText === 'Gap').click()"
        )
        progress_texts = set()
        while not page.run("return document.querySelector('[data-derived=gap], .error')"):
            # The progress may end between the two questions.
            text = page.run("return document.querySelector('.note [role=status]')?.innerText ?? ''")
            progress_texts.add(text)
            time.sleep(0.1)
        assert any(text.startswith("round ") for text in progress_texts), page.run(
            "return document.body.innerText"
        )
        result_text = page.run("return document.querySelector('.recording').innerText")
        assert "explained: gap" in result_text and "wheel camber (right)" in result_text
        assert page.console_messages() == []
        page.save_screenshot("gap")
        page.open("pages/gap/ride.mcap")
        assert "wheel leans" in page.run("return document.body.innerText")
        until(lambda: page.run("return document.querySelectorAll('.main-svg').length") > 0)
    assert (folder / "pages" / "ride.mcap" / "gap" / "gap.json").is_file()


def test_with_a_certificate_only_https_is_served(folder, tmp_path):
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    command = [
        wanted.program("openssl"),
        *["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"],
    ]
    command += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(cert)]
    subprocess.run(command, check=True, capture_output=True)
    site = Site(Address("127.0.0.1", 0), cert=cert, key=key)
    with serve_in_thread(make_app(site, RecordingLibrary(folder)), site) as port:
        trusting = ssl.create_default_context(cafile=str(cert))
        with urllib.request.urlopen(f"https://127.0.0.1:{port}/api/recordings", context=trusting) as answer:
            assert b"ride.mcap" in answer.read()
        with pytest.raises(OSError):
            urllib.request.urlopen(f"http://127.0.0.1:{port}/api/recordings")
    cert.write_text("no certificate")
    with pytest.raises(InputError, match="PEM"), serve_in_thread(None, site):
        pass
