"""The report opens in a real browser, alone and without a complaint, and its figures are drawn."""

import subprocess

import wanted


def test_the_report_opens_without_errors_and_draws_its_figures(named, tmp_path):
    page = named.folder / "report.html"
    assert page.stat().st_size < 6e6
    shown = subprocess.run(
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
    complaints = [line for line in shown.stderr.splitlines() if "CONSOLE" in line]
    assert complaints == []
    figures = page.read_text("utf-8").count('class="figure"')
    assert shown.stdout.count('class="main-svg"') >= figures >= 5
    assert "The wheel leans (right)" in shown.stdout
    assert "[nodes.right.effects.wheel_camber]" in shown.stdout
