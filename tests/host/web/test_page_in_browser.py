"""The live page in a real browser: content, buttons, restart of the recorder, accessibility."""

import pytest

import wanted
from browser_page import Page
from hubowire.messages import BiasInit
from page_recorder import RecorderWithPage
from waiting import until

pytestmark = pytest.mark.real_time


@pytest.fixture(scope="module")
def recorder(tmp_path_factory):
    running = RecorderWithPage(tmp_path_factory.mktemp("rig"))
    with running.nodes[0], running.nodes[1]:
        running.start()
        yield running
        running.stop()


@pytest.fixture(scope="module")
def page(recorder, tmp_path_factory):
    with Page(f"http://127.0.0.1:{recorder.port}/", tmp_path_factory.mktemp("profile")) as browser_page:
        open_page(browser_page)
        yield browser_page


def open_page(page):
    page.open()
    until(lambda: page.run("return document.querySelectorAll('.node').length") == 2)


def test_the_page_shows_path_speeds_heading_nodes_log_and_events_without_console_errors(page):
    until(lambda: page.text("now-speed").replace("−", "").replace(".", "").isdigit())
    assert page.text("state") == "recording"
    assert page.text("file-name") == "ride1.mcap"
    assert "GB" in page.text("disk-left")
    assert page.text("speed-title") == "Wheel speeds, m/s"
    until(lambda: all(page.is_drawn(name) for name in ("map", "speeds", "headings", "compass")))
    for name in ("left", "right"):
        script = f"return document.querySelector(`[aria-label='Node {name}']`).innerText"
        for text in ("streaming", " Hz", "3.70 V", "26.0 °C"):
            until(lambda script=script, text=text: text in page.run(script))
    until(lambda: "connected" in page.text("events"))
    assert page.console_messages() == []


def test_the_page_opens_with_the_last_minute(page):
    open_page(page)
    seconds = page.run(
        "const live = new WebSocket(`ws://${location.host}/live`);"
        "return new Promise((done) => { live.onmessage = (event) => { live.close();"
        "const history = JSON.parse(event.data).history; done(history.at(-1).t - history[0].t); }; });"
    )
    shown = page.run("return document.getElementById('file-time').textContent")
    assert seconds >= min(55, 60 * int(shown.split(":")[1]) + int(shown.split(":")[2]) - 3)
    assert "powered on" in page.text("events")
    assert page.console_messages() == []


def test_the_buttons_mark_initialise_the_bias_and_stop_and_start_the_log(page, recorder):
    page.run("document.getElementById('mark-text').value = 'a bump'")
    page.click("#mark button")
    until(lambda: "a bump" in page.text("events"))
    page.click("[aria-label='Node right'] .bias button")
    until(lambda: "right: bias initialisation over 2000 samples: done" in page.text("events"))
    assert [m for m in recorder.nodes[1].requests if isinstance(m, BiasInit)] == [BiasInit(2000)]
    page.click("#record")
    until(lambda: page.text("state") != "recording")
    assert page.text("record") == "Start recording"
    page.click("#record")
    until(lambda: page.text("state") == "recording")
    assert len(list(recorder.folder.glob("ride1*.mcap"))) == 2
    assert page.console_messages() == []


def test_recordings_are_listed_with_their_content(page):
    page.click("[data-view=recordings]")
    until(lambda: page.run("return document.querySelectorAll('.recording').length") == 2)
    page.click("[aria-label='ride1.mcap'] button")
    until(lambda: page.run("return document.querySelectorAll('.facts').length"))
    facts = page.run("return document.querySelector('.facts').innerText")
    assert "/left/imu" in facts and "Hz" in facts
    page.save_screenshot("recordings")
    assert page.call_in_page("lowContrastTexts()") == []
    page.click("[data-view=live]")
    assert page.console_messages() == []


def test_every_control_is_reachable_by_keyboard_with_a_visible_focus(page):
    keys = wanted.module("selenium.webdriver.common.keys").Keys
    actions = wanted.module("selenium.webdriver").ActionChains
    page.run("document.activeElement.blur(); window.scrollTo(0, 0)")
    n_controls = page.call_in_page("countFocusable()")
    reached = set()
    for _ in range(n_controls + 3):
        actions(page.driver).send_keys(keys.TAB).perform()
        reached.add(page.run("return [...document.querySelectorAll('*')].indexOf(document.activeElement)"))
        assert page.call_in_page("hasVisibleFocus()")
    assert len(reached) >= n_controls
    page.run("document.activeElement.blur()")
    actions(page.driver).send_keys("m").perform()
    actions(page.driver).send_keys("by hand" + keys.ENTER).perform()
    until(lambda: "by hand" in page.text("events"))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_all_texts_have_contrast_in_both_schemes_and_nothing_is_cut_off_on_a_phone(page, scheme):
    page.colours(scheme)
    try:
        page.size(1400, 1500)
        until(lambda: page.run("return document.documentElement.dataset.theme") == scheme)
        until(lambda: page.is_drawn("map"))
        assert page.call_in_page("lowContrastTexts()") == []
        page.save_screenshot(f"live-{scheme}")
        page.size(360, 740)
        until(lambda: page.run("return window.innerWidth") == 360)
        assert page.run("return document.documentElement.scrollWidth") <= 360
        page.save_screenshot(f"phone-{scheme}")
        page.click("[data-view=recordings]")
        until(lambda: page.run("return document.querySelectorAll('.recording').length") >= 2)
        assert page.run("return document.documentElement.scrollWidth") <= 360
        page.click("[data-view=live]")
    finally:
        page.size(1400, 900)
        page.colours("light")


def test_the_page_reconnects_after_a_restart_of_the_recorder(page, recorder):
    assert f"hubodo record: live page at http://127.0.0.1:{recorder.port}/" in recorder.stop()
    until(lambda: page.run("return !document.getElementById('lost').hidden"))
    assert page.text("state") == "no connection"
    page.save_screenshot("lost")
    recorder.start()
    until(lambda: page.run("return document.getElementById('lost').hidden"))
    until(lambda: page.text("file-name") == "ride2.mcap")
    page.run("document.getElementById('mark-text').value = 'again'")
    page.click("#mark button")
    until(lambda: "again" in page.text("events"))
    errors = [line for line in page.console_messages() if "ERR_CONNECTION_REFUSED" not in line]
    assert [line for line in errors if "WebSocket connection" not in line] == []
