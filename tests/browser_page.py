"""A page in headless Chromium, controlled and queried by tests. Screenshots are saved in out/screenshots."""

import os
from pathlib import Path

import wanted

TESTS = Path(__file__).parent
SCREENSHOTS = TESTS.parent / "out" / "screenshots"
IN_PAGE = (TESTS / "in_page.js").read_text()


class Page:
    """A browser with one page."""

    def __init__(self, url, profile):
        webdriver = wanted.module("selenium.webdriver")
        self.url = url
        options = webdriver.ChromeOptions()
        options.binary_location = wanted.program("chromium", "chromium-browser", "google-chrome")
        for argument in ("--headless=new", "--disable-gpu", "--no-first-run", f"--user-data-dir={profile}"):
            options.add_argument(argument)
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            options.add_argument("--no-sandbox")
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        service = webdriver.ChromeService(wanted.program("chromedriver"))
        self.driver = webdriver.Chrome(options=options, service=service)
        self.size(1400, 900)
        self.colours("light")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.driver.quit()

    def size(self, width, height):
        values = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", values)

    def colours(self, scheme):
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})

    def open(self, path=""):
        self.driver.get(self.url + path)

    def run(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def call_in_page(self, call):
        return self.run(f"{IN_PAGE}\nreturn {call};")

    def is_drawn(self, name):
        return self.call_in_page(f"countColours('{name}')") > 3

    def text(self, name):
        return self.run("return document.getElementById(arguments[0]).textContent", name)

    def click(self, selector):
        self.run("document.querySelector(arguments[0]).click()", selector)

    def console_messages(self):
        return [line["message"] for line in self.driver.get_log("browser")]

    def save_screenshot(self, name):
        SCREENSHOTS.mkdir(parents=True, exist_ok=True)
        assert self.driver.save_screenshot(str(SCREENSHOTS / f"{name}.png"))
