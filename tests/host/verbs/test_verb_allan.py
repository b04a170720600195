"""`hubodo allan` on records of the world: knocked, in another unit, several at once, beside a data sheet."""

import json
import re

import allantools
import numpy as np
import pytest

from generators.noise import gyro_noise
from hubodo.cli import main

HZ, SAMPLES = 100.0, 60_000
DEG = np.pi / 180.0


def rates(seed, n=3e-4):
    return gyro_noise(SAMPLES, 1.0 / HZ, np.random.default_rng(seed), n=n, b=5e-5)


def column(path, values):
    np.savetxt(path, values, fmt="%.17g")
    return str(path)


def run(*words, capsys):
    assert main([*map(str, words), "--json"]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


def told(*words, capsys):
    assert main([*map(str, words)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_as_is_is_what_allantools_makes_of_every_sample(tmp_path, capsys):
    values = rates(1) - rates(1).mean()
    values[30_000:30_100] += 0.5
    log = column(tmp_path / "g.csv", values)
    found = run("allan", log, "--rate", HZ, "--unit", "rad/s", "--as-is", capsys=capsys)
    _, theirs, _, _ = allantools.oadev(values, rate=HZ, data_type="freq", taus=found["tau"])
    assert found["adev"] == pytest.approx(theirs, rel=1e-12)
    assert found["excluded"] == []
    assert found["record"]["samples"] == SAMPLES


def test_a_knock_and_a_turn_are_cut_out_told_and_leave_the_terms_as_they_are(tmp_path, capsys):
    clean, rng = rates(2), np.random.default_rng(3)
    hurt = clean.copy()
    hurt[20_000:20_100] += rng.normal(0.0, 0.3, 100)
    # Turned at a steady rate for 20 s: quiet meanwhile, but at another level.
    hurt[40_000:42_000] += 0.05
    options = ("--rate", HZ, "--unit", "rad/s")
    expected = run("allan", column(tmp_path / "clean.csv", clean), *options, capsys=capsys)
    log = column(tmp_path / "hurt.csv", hurt)
    found = run("allan", log, *options, capsys=capsys)
    (knock, turn) = ((it["start"], it["end"]) for it in found["excluded"])
    assert 198.0 <= knock[0] <= 200.0 and 201.0 <= knock[1] <= 203.0
    assert 398.0 <= turn[0] <= 400.0 and 420.0 <= turn[1] <= 423.0
    assert any("cut out and treated as gaps" in note for note in found["notes"])
    n, sigma = found["coefficients"]["N"]["value"], found["coefficients"]["N"]["sigma"]
    assert n == pytest.approx(expected["coefficients"]["N"]["value"], abs=sigma)
    shown = [place for place, tau in enumerate(found["tau"]) if tau < 20.0]
    for place in shown:
        assert found["adev"][place] == pytest.approx(expected["adev"][place], rel=0.06), found["tau"][place]
    # Plain, the knock and the turn are ten times the noise.
    plain = run("allan", log, *options, "--as-is", capsys=capsys)
    assert max(plain["adev"][8:]) > 5.0 * max(found["adev"][8:])
    hurt[10_000:30_000] += rng.normal(0.0, 0.02, 20_000)
    assert "too much to cut out" in told("allan", column(tmp_path / "bad.csv", hurt), *options, capsys=capsys)


def test_degrees_that_pass_as_radians_are_refused_by_their_white_noise(tmp_path, capsys):
    """0.3 °/√h is usual; in degrees taken for radians it is 17 °/√h, which no gyro has."""
    values = rates(4, n=0.3 / 60.0)
    log = column(tmp_path / "g.csv", values)
    line = told("allan", log, "--rate", HZ, "--unit", "rad/s", capsys=capsys)
    assert re.search(r"angle random walk of 1[678]", line) and "--unit deg/s" in line
    found = run("allan", log, "--rate", HZ, "--unit", "deg/s", capsys=capsys)
    assert found["coefficients"]["N"]["value_deg_per_sqrt_h"] == pytest.approx(0.3, rel=0.05)
    assert main(["allan", log, "--rate", str(HZ), "--unit", "rad/s", "--trust-units", "--json"]) == 0


def test_several_sensors_make_one_table_one_figure_and_one_page_with_a_data_sheet(tmp_path, capsys):
    logs = [
        column(tmp_path / f"{name}.csv", rates(seed, n)) for name, seed, n in (("a", 5, 3e-4), ("b", 6, 6e-4))
    ]
    sheet = tmp_path / "mine.toml"
    sheet.write_text(
        'name = "MY1"\n[gyro]\nnoise_density = 0.02   # deg/s/√Hz\nbias_instability = 10.0\n', "utf-8"
    )
    words = [*logs, "--rate", HZ, "--unit", "rad/s", "--datasheet", "mpu-6050", "--datasheet", sheet]
    found = run("allan", *words, capsys=capsys)
    assert [it["coefficients"]["N"]["value"] for it in found["sensors"]] == pytest.approx(
        [3e-4, 6e-4], rel=0.03
    )
    chip, mine = found["datasheets"]
    # One-sided densities: N is smaller by the root of two.
    assert chip["gyro"]["N"] == pytest.approx(0.005 * DEG / np.sqrt(2))
    assert mine["gyro"] == pytest.approx({"N": 0.02 * DEG / np.sqrt(2), "B": 10.0 * DEG / 3600.0})
    page, picture = tmp_path / "p.html", tmp_path / "p.svg"
    assert main(["allan", *map(str, words), "--report", str(page), "--figure", str(picture)]) == 0
    out = capsys.readouterr().out
    for name in ("a.csv a gz", "b.csv b gz", "MY1, data sheet"):
        assert name in out
    assert picture.read_bytes().startswith(b"<?xml")
    text = page.read_text("utf-8")
    assert ">10⁻³<" in text and "10^{" not in text
    assert len(text) < 1_000_000
    assert "What to do" in text and "MPU-6050, data sheet" in text and text.count("<svg") == 3
    # What is used by its name within a figure has that name nowhere else on the page.
    names = re.findall(r'\bid="([^"]+)"', text)
    used = set(re.findall(r'(?:href="|url\()#([^")]+)', text))
    assert used and all(names.count(name) == 1 for name in used)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--datasheet", "LSM9"), "no such file, and no chip of LSM6DS33"),
        (("--channel", "gz,ax"), "gyro and accelerometer have different units"),
        (("--channel", "wz"), "choose from gx"),
        (("--channel", "gx"), "has no gx; use --channel with gz"),
        (("--rate", "0"), "--rate: 0: write a number above 0"),
        (("--unit", "deg/s"), "at most one for the gyro"),
    ],
)
def test_wrong_use_is_one_line(tmp_path, words, said, capsys):
    log = tmp_path / "left.csv"
    log.write_text("t,gz\n" + "".join(f"{k / 100},{k % 7 * 1e-4}\n" for k in range(600)), "utf-8")
    assert said in told("allan", log, "--unit", "rad/s", *words, capsys=capsys)
