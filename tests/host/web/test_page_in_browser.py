"""The page in a real browser: shows the recording, takes wishes, survives a restart, can be read by all."""

import contextlib
import os
import random
import socket
import subprocess
import sys
from pathlib import Path

import pytest

import wanted
from browser_page import Page
from fakes.fake_node import FakeNode
from generators.fake_drive import VEHICLE_TOML, raw_rows, short_drive
from hubowire.messages import BiasInit
from waiting import until

pytestmark = pytest.mark.real_time
ROOT = Path(__file__).resolve().parents[3]


def free_port():
    """Below those that the system hands out by itself: one of them may be another test's a moment later."""
    for port in random.Random(os.getpid()).sample(range(15_000, 30_000), 100):
        with contextlib.suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port
    raise OSError("no port is free")


class Rig:
    """Two fake nodes in real time, and a recorder with its page that can be ended and begun again."""

    def __init__(self, folder):
        self.folder, self.logs = folder, 0
        (folder / "vehicle.toml").write_text(VEHICLE_TOML)
        self.port = free_port()
        drive = short_drive(5, 104.0)
        self.nodes = [
            FakeNode(
                node_id=number,
                rate_hz=104.0,
                rows=raw_rows(drive, name) * 3,
                bias_q12=(900, -1400, 600),
                serial=f"FAKE000{number}".encode(),
            )
            for number, name in ((1, "left"), (2, "right"))
        ]
        self.process = None

    def begin(self):
        self.logs += 1
        ports = [node.path for node in self.nodes]
        words = ["record", *ports, "-o", self.folder / f"ride{self.logs}.mcap"]
        words += ["--vehicle", self.folder / "vehicle.toml", f"--web=127.0.0.1:{self.port}"]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hubodo.cli", *map(str, words)],
            env={**os.environ, "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        until(self.listens)

    def listens(self):
        assert self.process.poll() is None, self.process.stderr.read()
        with contextlib.suppress(OSError):
            socket.create_connection(("127.0.0.1", self.port), timeout=1).close()
            return True

    def end(self):
        self.process.terminate()
        return self.process.communicate(timeout=300)[1].decode()


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    made = Rig(tmp_path_factory.mktemp("rig"))
    with made.nodes[0], made.nodes[1]:
        made.begin()
        yield made
        made.end()


@pytest.fixture(scope="module")
def page(rig, tmp_path_factory):
    with Page(f"http://127.0.0.1:{rig.port}/", tmp_path_factory.mktemp("profile")) as made:
        opened(made)
        yield made


def opened(page):
    page.open()
    until(lambda: page.run("return document.querySelectorAll('.node').length") == 2)


def test_it_shows_path_speeds_heading_nodes_log_and_events_without_a_complaint(page):
    until(lambda: page.text("now-speed").replace("−", "").replace(".", "").isdigit())
    assert page.text("state") == "recording"
    assert page.text("file-name") == "ride1.mcap"
    assert "GB" in page.text("disk-left")
    assert page.text("speed-title") == "Wheel speeds, m/s"
    until(lambda: all(page.drawn(name) for name in ("map", "speeds", "headings", "compass")))
    for name in ("left", "right"):
        script = f"return document.querySelector(`[aria-label='Node {name}']`).innerText"
        for words in ("streaming", " Hz", "3.70 V", "26.0 °C"):
            until(lambda script=script, words=words: words in page.run(script))
    until(lambda: "connected" in page.text("events"))
    assert page.console() == []


def test_it_has_the_last_minute_at_once_on_opening(page):
    opened(page)
    seconds = page.run(
        "const live = new WebSocket(`ws://${location.host}/live`);"
        "return new Promise((done) => { live.onmessage = (event) => { live.close();"
        "const past = JSON.parse(event.data).history; done(past.at(-1).t - past[0].t); }; });"
    )
    shown = page.run("return document.getElementById('file-time').textContent")
    assert seconds >= min(55, 60 * int(shown.split(":")[1]) + int(shown.split(":")[2]) - 3)
    assert "powered on" in page.text("events")
    assert page.console() == []


def test_its_buttons_work(page, rig):
    page.run("document.getElementById('mark-text').value = 'a bump'")
    page.click("#mark button")
    until(lambda: "a bump" in page.text("events"))
    page.click("[aria-label='Node right'] .bias button")
    until(lambda: "right: bias initialisation over 2000 samples: done" in page.text("events"))
    assert [m for m in rig.nodes[1].requests if isinstance(m, BiasInit)] == [BiasInit(2000)]
    page.click("#record")
    until(lambda: page.text("state") != "recording")
    assert page.text("record") == "Start recording"
    page.click("#record")
    until(lambda: page.text("state") == "recording")
    assert len(list(rig.folder.glob("ride1*.mcap"))) == 2
    assert page.console() == []


def test_recordings_are_listed_and_say_what_they_hold(page):
    page.click("[data-view=recordings]")
    until(lambda: page.run("return document.querySelectorAll('.recording').length") == 2)
    page.click("[aria-label='ride1.mcap'] button")
    until(lambda: page.run("return document.querySelectorAll('.facts').length"))
    facts = page.run("return document.querySelector('.facts').innerText")
    assert "/left/imu" in facts and "Hz" in facts
    page.keep("recordings")
    assert page.ask("faintWords()") == []
    page.click("[data-view=live]")
    assert page.console() == []


def test_everything_is_reached_with_the_keyboard_and_shows_where_it_is(page):
    keys = wanted.module("selenium.webdriver.common.keys").Keys
    actions = wanted.module("selenium.webdriver").ActionChains
    page.run("document.activeElement.blur(); window.scrollTo(0, 0)")
    want = page.ask("reachable()")
    reached = set()
    for _ in range(want + 3):
        actions(page.driver).send_keys(keys.TAB).perform()
        reached.add(page.run("return [...document.querySelectorAll('*')].indexOf(document.activeElement)"))
        assert page.ask("focusShown()")
    assert len(reached) >= want
    page.run("document.activeElement.blur()")
    actions(page.driver).send_keys("m").perform()
    actions(page.driver).send_keys("by hand" + keys.ENTER).perform()
    until(lambda: "by hand" in page.text("events"))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_all_its_words_can_be_read_in_both_schemes_and_on_a_phone_nothing_is_cut(page, scheme):
    page.colours(scheme)
    try:
        page.size(1400, 1500)
        until(lambda: page.run("return document.documentElement.dataset.theme") == scheme)
        until(lambda: page.drawn("map"))
        assert page.ask("faintWords()") == []
        page.keep(f"live-{scheme}")
        page.size(360, 740)
        until(lambda: page.run("return window.innerWidth") == 360)
        assert page.run("return document.documentElement.scrollWidth") <= 360
        page.keep(f"phone-{scheme}")
        page.click("[data-view=recordings]")
        until(lambda: page.run("return document.querySelectorAll('.recording').length") >= 2)
        assert page.run("return document.documentElement.scrollWidth") <= 360
        page.click("[data-view=live]")
    finally:
        page.size(1400, 900)
        page.colours("light")


def test_it_survives_a_restart_of_the_recorder_and_its_buttons_work_again(page, rig):
    assert f"hubodo record: live page at http://127.0.0.1:{rig.port}/" in rig.end()
    until(lambda: page.run("return !document.getElementById('lost').hidden"))
    assert page.text("state") == "no connection"
    page.keep("lost")
    rig.begin()
    until(lambda: page.run("return document.getElementById('lost').hidden"))
    until(lambda: page.text("file-name") == "ride2.mcap")
    page.run("document.getElementById('mark-text').value = 'again'")
    page.click("#mark button")
    until(lambda: "again" in page.text("events"))
    complaints = [line for line in page.console() if "ERR_CONNECTION_REFUSED" not in line]
    assert [line for line in complaints if "WebSocket connection" not in line] == []
