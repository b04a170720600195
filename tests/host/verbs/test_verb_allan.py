"""`hubodo allan` on real-world records: disturbed, in another unit, several at once, beside a data sheet."""

import json
import re

import allantools
import numpy as np
import pytest

from generators.noise import gyro_noise
from hubodo.cli import main

HZ, SAMPLES = 100.0, 60_000
DEG = np.pi / 180.0


def gyro_rates(seed, n=3e-4):
    return gyro_noise(SAMPLES, 1.0 / HZ, np.random.default_rng(seed), n=n, b=5e-5)


def write_column(path, values):
    np.savetxt(path, values, fmt="%.17g")
    return str(path)


def run(*arguments, capsys):
    assert main([*map(str, arguments), "--json"]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


def refusal(*arguments, capsys):
    assert main([*map(str, arguments)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_as_is_equals_allantools_on_all_samples(tmp_path, capsys):
    values = gyro_rates(1) - gyro_rates(1).mean()
    values[30_000:30_100] += 0.5
    log = write_column(tmp_path / "g.csv", values)
    result = run("allan", log, "--rate", HZ, "--unit", "rad/s", "--as-is", capsys=capsys)
    _, theirs, _, _ = allantools.oadev(values, rate=HZ, data_type="freq", taus=result["tau"])
    assert result["adev"] == pytest.approx(theirs, rel=1e-12)
    assert result["excluded"] == []
    assert result["record"]["samples"] == SAMPLES


def test_a_knock_and_a_rotation_are_cut_out_reported_and_do_not_change_the_noise_terms(tmp_path, capsys):
    clean, rng = gyro_rates(2), np.random.default_rng(3)
    disturbed = clean.copy()
    disturbed[20_000:20_100] += rng.normal(0.0, 0.3, 100)
    # A constant rotation for 20 s: low noise, but at another level.
    disturbed[40_000:42_000] += 0.05
    options = ("--rate", HZ, "--unit", "rad/s")
    expected = run("allan", write_column(tmp_path / "clean.csv", clean), *options, capsys=capsys)
    log = write_column(tmp_path / "hurt.csv", disturbed)
    result = run("allan", log, *options, capsys=capsys)
    (knock, turn) = ((it["start"], it["end"]) for it in result["excluded"])
    assert 198.0 <= knock[0] <= 200.0 and 201.0 <= knock[1] <= 203.0
    assert 398.0 <= turn[0] <= 400.0 and 420.0 <= turn[1] <= 423.0
    assert any("cut out and treated as gaps" in note for note in result["notes"])
    n, sigma = result["coefficients"]["N"]["value"], result["coefficients"]["N"]["sigma"]
    assert n == pytest.approx(expected["coefficients"]["N"]["value"], abs=sigma)
    short_times = [index for index, tau in enumerate(result["tau"]) if tau < 20.0]
    for index in short_times:
        assert result["adev"][index] == pytest.approx(expected["adev"][index], rel=0.06), result["tau"][index]
    # Without removing them, the knock and the rotation dominate the noise.
    plain = run("allan", log, *options, "--as-is", capsys=capsys)
    assert max(plain["adev"][8:]) > 5.0 * max(result["adev"][8:])
    disturbed[10_000:30_000] += rng.normal(0.0, 0.02, 20_000)
    assert "too much to cut out" in refusal(
        "allan", write_column(tmp_path / "bad.csv", disturbed), *options, capsys=capsys
    )


def test_a_stated_unit_is_believed_however_noisy_it_makes_the_gyro(tmp_path, capsys):
    """0.3 °/√h is typical; degrees stated as radians give 17 °/√h, which few gyros have."""
    log = write_column(tmp_path / "g.csv", gyro_rates(4, n=0.3 / 60.0))
    for unit, expected in (("deg/s", 0.3), ("rad/s", np.degrees(0.3))):
        result = run("allan", log, "--rate", HZ, "--unit", unit, capsys=capsys)
        assert result["coefficients"]["N"]["value_deg_per_sqrt_h"] == pytest.approx(expected, rel=0.05)


def test_several_sensors_and_data_sheets_share_one_table_and_a_page_that_needs_no_network(tmp_path, capsys):
    logs = [
        write_column(tmp_path / f"{name}.csv", gyro_rates(seed, n)[:20_000])
        for name, seed, n in (("a", 5, 3e-4), ("b", 6, 6e-4))
    ]
    sheet = tmp_path / "mine.toml"
    sheet.write_text(
        'name = "MY1"\n[gyro]\nnoise_density = 0.02   # deg/s/√Hz\nbias_instability = 10.0\n', "utf-8"
    )
    arguments = [*logs, "--rate", HZ, "--unit", "rad/s", "--datasheet", "mpu-6050", "--datasheet", sheet]
    result = run("allan", *arguments, capsys=capsys)
    assert [it["coefficients"]["N"]["value"] for it in result["sensors"]] == pytest.approx(
        [3e-4, 6e-4], rel=0.03
    )
    chip, own_sheet = result["datasheets"]
    # Data sheets give one-sided densities: N is smaller by √2.
    assert chip["gyro"]["N"] == pytest.approx(0.005 * DEG / np.sqrt(2))
    assert own_sheet["gyro"] == pytest.approx({"N": 0.02 * DEG / np.sqrt(2), "B": 10.0 * DEG / 3600.0})
    page = tmp_path / "p.html"
    assert main(["allan", *map(str, arguments), "--report", str(page)]) == 0
    out = capsys.readouterr().out
    for name in ("a.csv a gz", "b.csv b gz", "MY1, data sheet"):
        assert name in out
    text = page.read_text("utf-8")
    assert ">10⁻³<" in text and "10^{" not in text
    assert "<script" not in text and "<svg" in text and len(text) < 1_000_000
    assert "What to do" in text and "MPU-6050, data sheet" in text and text.count('class="on-wide"') == 3
    # Each id referenced within a figure is unique on the page.
    names = re.findall(r'\bid="([^"]+)"', text)
    used = set(re.findall(r'(?:href="|url\()#([^")]+)', text))
    assert used and all(names.count(name) == 1 for name in used)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--datasheet", "LSM9"), "no such file, and no chip of LSM6DS33"),
        (("--channel", "gz,ax"), "gyro and accelerometer have different units"),
        (("--channel", "wz"), "choose from gx"),
        (("--channel", "gx"), "has no gx; use --channel with gz"),
        (("--rate", "0"), "--rate: 0: write a number above 0"),
        (("--unit", "deg/s"), "at most one for the gyro"),
    ],
)
def test_wrong_usage_is_refused_in_one_line(tmp_path, arguments, message, capsys):
    log = tmp_path / "left.csv"
    log.write_text("t,gz\n" + "".join(f"{k / 100},{k % 7 * 1e-4}\n" for k in range(600)), "utf-8")
    assert message in refusal("allan", log, "--unit", "rad/s", *arguments, capsys=capsys)
