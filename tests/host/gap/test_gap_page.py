"""The report opens in a real browser without network or console messages and draws its figures."""

import subprocess

import wanted


def test_the_report_opens_without_errors_and_draws_its_figures(camber_run, tmp_path):
    page = camber_run.folder / "report.html"
    assert page.stat().st_size < 6e6
    browser = subprocess.run(
        [
            wanted.program("chromium", "chromium-browser", "google-chrome"),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={tmp_path / 'profile'}",
            "--enable-logging=stderr",
            "--virtual-time-budget=8000",
            "--dump-dom",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    console_messages = [line for line in browser.stderr.splitlines() if "CONSOLE" in line]
    assert console_messages == []
    figures = page.read_text("utf-8").count('class="figure"')
    assert browser.stdout.count('class="main-svg"') >= figures >= 5
    assert "The wheel leans (right)" in browser.stdout
    assert "[nodes.right.effects.wheel_camber]" in browser.stdout
