"""Write each page by its verb and photograph it in headless Chromium: wide and narrow, light and dark.

The live page shows two fake nodes in real time, the recordings page the logs that the verbs have written.

`python tests/pages/screenshots.py` writes pages and screenshots into out/pages, and lists texts of low
contrast and pages that are wider than a phone. `--only demo report` restricts it, `--update` renews the
images of the README: demo.png, gap.png and live.png in host/images.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from browser_page import Page  # noqa: E402
from generators.fake_drive import planned_drive  # noqa: E402
from hubodo.web.address import Address  # noqa: E402
from hubodo.web.app import make_app  # noqa: E402
from hubodo.web.config import Site  # noqa: E402
from hubodo.web.library import RecordingLibrary  # noqa: E402
from hubodo.web.server import serve_in_thread  # noqa: E402
from page_recorder import RATE_HZ, RecorderWithPage  # noqa: E402
from waiting import until  # noqa: E402

FOLDER = ROOT / "out" / "pages"
WIDTHS = {"wide": 1300, "phone": 390}
SCHEMES = ("light", "dark")
README_WIDTHS = {"demo": 945, "gap": 1000, "live": 1295}
MAX_README_HEIGHT = 2080
TABLE_MODEL = "model.toml --drive turntable --latitude-deg 48 --rate 50 --force"
CASE = f"{sys.executable} {ROOT}/tests/gap_matrix/make_case.py --effect wheel_camber --effect gyro_warmup"

COMMANDS: dict[str, tuple[str, ...]] = {
    "demo": ("hubodo demo -o demo",),
    "report": ("hubodo report drive.mcap --vehicle vehicle.toml -o report.html --force",),
    "calibrate_wheels": (
        "hubodo calibrate wheels drive.mcap --vehicle vehicle.toml -o wheels.toml --force"
        " --report calibrate_wheels.html",
    ),
    "calibrate_imu": (
        "hubodo simulate bench.toml --drive poses --duration 160 --calibration c.toml -o poses.mcap --force",
        "hubodo calibrate imu poses.mcap --node left -o imu.toml --report calibrate_imu.html --force",
    ),
    "gap": (
        f"{CASE} --factor 1 --seed 11 --seconds 120 -o case",
        "hubodo gap case/model.toml case -o gap --force",
    ),
    "allan": ("hubodo allan night.mcap --node left --channel gz --report allan.html --force",),
    "warmup": ("hubodo warmup night.mcap --node left --channel gz --report warmup.html --force",),
    "north": (
        f"hubodo simulate {TABLE_MODEL} --duration 400 --azimuth-deg 30 -o table.mcap",
        "hubodo north table.mcap --latitude-deg 48 --node left --axis y --report north.html --force",
    ),
    "filters": (
        f"hubodo simulate {TABLE_MODEL} --duration 400 --azimuth-deg 30 -o table.mcap",
        "hubodo filters table.mcap --node left --channel gz --reference table --report filters.html --force",
    ),
    "heading": (
        f"hubodo simulate {TABLE_MODEL} --duration 400 --azimuth-deg 30 -o table.mcap",
        "hubodo heading table.mcap --node left --report heading.html --force",
    ),
    "sheet": (
        "hubodo simulate bench.toml --drive poses --duration 160 --calibration c.toml -o poses.mcap --force",
        "hubodo sheet --still night.mcap --poses poses.mcap --node left -o sheet --force",
    ),
    "fleet": ("hubodo batch fuse drive.mcap night.mcap -o fleet",),
}
"""Commands that write a page, run in a folder with the files of `hubodo example`."""
PAGES = {
    "demo": "demo/*/index.html",
    "gap": "gap/report.html",
    "fleet": "fleet/fleet.html",
    "sheet": "sheet/sheet.html",
}
"""Patterns of pages with another name than `<page>.html`; the newest file counts."""


SERVED_PAGES = ("live", "recordings")
RIDE_SECONDS = 45.0
RIDE = [(20.0, 0.0, 0.0), (9.0, 1.0, 0.3), (9.0, 1.2, -0.35), (9.0, 0.8, 0.3), (60.0, 1.0, 0.1)]
"""Legs of the ride: duration s, speed m/s, yaw rate rad/s; it begins with a standstill."""
SETTLING_SECONDS = 4.0  # until the page has its data and has drawn it


def write_page(name: str, folder: Path) -> Path:
    """Run the commands of a page and return its file."""
    for command in COMMANDS[name]:
        done = subprocess.run(command.split(), cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"{command}: exit code {done.returncode}: {done.stderr.strip()}")
    return max(folder.glob(PAGES.get(name, f"{name}.html")), key=lambda file: file.stat().st_mtime)


def capture(page: Page, target: Path, max_height: int = 20_000) -> None:
    """Save the whole page as PNG, cut at a height in pixels."""
    width, height = page.run(
        "return [document.documentElement.clientWidth, document.documentElement.scrollHeight]"
    )
    clip = {"x": 0, "y": 0, "width": width, "height": min(height, max_height), "scale": 1}
    options = {"format": "png", "captureBeyondViewport": True, "clip": clip}
    image = page.driver.execute_cdp_cmd("Page.captureScreenshot", options)["data"]
    target.write_bytes(base64.b64decode(image))


def reduce_palette(path: Path) -> None:
    """Rewrite a PNG with 256 colours, a third of its size."""
    from PIL import Image

    Image.open(path).convert("RGB").quantize(256).save(path, optimize=True)


@contextlib.contextmanager
def served_page(name: str) -> Iterator[str]:
    """Yield the address of the live page, or of the page of the recordings, while it is served."""
    if name == "recordings":
        site = Site(Address("127.0.0.1", 0))
        with serve_in_thread(make_app(site, RecordingLibrary(FOLDER)), site) as port:
            yield f"http://127.0.0.1:{port}/"
        return
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        recorder = RecorderWithPage(Path(folder), planned_drive(RIDE, 5, RATE_HZ))
        for node in recorder.nodes:
            stack.enter_context(node)
        recorder.start()
        stack.callback(recorder.stop)
        time.sleep(RIDE_SECONDS)
        yield f"http://127.0.0.1:{recorder.port}/"


def inspect(page: Page, name: str) -> list[str]:
    """Take the four screenshots of the open page; return its defects."""
    defects = []
    for width_name, width in WIDTHS.items():
        for scheme in SCHEMES:
            page.colours(scheme)
            page.size(width, 900)
            page.open()
            if name in SERVED_PAGES:
                time.sleep(SETTLING_SECONDS)
                until(lambda: not page.run("return document.querySelectorAll('.thumbnail:empty').length"))
            capture(page, FOLDER / f"{name}-{width_name}-{scheme}.png")
            used = page.run("return document.documentElement.scrollWidth")
            if used > width:
                defects.append(f"{name}: {used} px wide on a screen of {width} px")
            defects += [
                f"{name}, {scheme}: contrast: {text}" for text in page.call_in_page("lowContrastTexts()")
            ]
    return defects


def main() -> int:
    """Write, show and inspect the pages."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = (*COMMANDS, *SERVED_PAGES)
    parser.add_argument("--only", nargs="+", choices=names, default=names)
    parser.add_argument("--update", action="store_true", help="renew the images of the README")
    args = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    subprocess.run(["hubodo", "example", "--force", "."], cwd=FOLDER, check=True, stdout=subprocess.DEVNULL)
    defects = []
    for name in args.only:
        with contextlib.ExitStack() as stack:
            served = name in SERVED_PAGES
            url = stack.enter_context(served_page(name)) if served else write_page(name, FOLDER).as_uri()
            profile = stack.enter_context(tempfile.TemporaryDirectory())
            page = stack.enter_context(Page(url, profile))
            defects += inspect(page, name)
            if args.update and name in README_WIDTHS:
                page.colours("light")
                page.size(README_WIDTHS[name], 900)
                page.open()
                if served:
                    time.sleep(SETTLING_SECONDS)
                image = ROOT / "host" / "images" / f"{name}.png"
                capture(page, image, MAX_README_HEIGHT)
                reduce_palette(image)
        print(f"{name}: {url}")
    print("\n".join(sorted(set(defects))) or "no defects")
    return bool(defects)


if __name__ == "__main__":
    sys.exit(main())
