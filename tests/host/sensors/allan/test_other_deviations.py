"""Modified, Hadamard and total deviation against allantools, the spectral density, and pooled biases."""

import json

import allantools
import numpy as np
import pytest

import hubodo
from hubodo.sensors.allan.other_deviations import DEVIATIONS, deviation, longest_span
from hubodo.sensors.even_grid import grid_all_samples, place_on_grid
from in_process import hubodo as run

RATE = 100.0


def samples(seed, count=3000):
    rng = np.random.default_rng(seed)
    return 1e-3 * rng.standard_normal(count) + 1e-5 * np.cumsum(rng.standard_normal(count))


@pytest.mark.parametrize("kind", DEVIATIONS)
def test_a_deviation_equals_that_of_allantools(kind):
    values = samples(1)
    theirs = {"modified": allantools.mdev, "hadamard": allantools.ohdev, "total": allantools.totdev}[kind]
    tau, ours = deviation(grid_all_samples(np.arange(len(values)) / RATE, values), kind)
    taus, expected, _, _ = theirs(values - values.mean(), rate=RATE, data_type="freq", taus=tau)
    assert len(taus) >= 10 and np.allclose(ours[: len(taus)], expected, rtol=1e-9)


def test_a_hadamard_deviation_ignores_a_ramp_and_white_noise_has_the_density_of_n():
    values = 1e-3 * np.random.default_rng(2).standard_normal(1 << 12)
    ramp = 1e-5 * np.arange(len(values))
    log = hubodo.from_arrays(np.column_stack([values, values + ramp, values]), rate=RATE)
    plain, ramped = log.allan(channel="gx"), log.allan(channel="gy")
    assert np.allclose(plain.deviation("hadamard")[1], ramped.deviation("hadamard")[1], rtol=1e-6)
    density = plain.spectral_density()[1]
    assert np.sqrt(np.mean(density**2) / 2.0) == pytest.approx(1e-4, rel=0.05)
    with pytest.raises(hubodo.InputError, match="choose from modified, hadamard, total"):
        plain.deviation("median")


def test_gaps_divide_a_record_and_single_missing_samples_are_interpolated():
    t = np.delete(np.arange(3000) / RATE, [700, *range(1200, 1300)])
    span = longest_span(place_on_grid(t, 1e-3 * np.sin(t)))
    assert len(span) == 1700 and span[0] == pytest.approx(1e-3 * np.sin(13.0))
    t = np.delete(t, slice(1199, None))
    assert longest_span(place_on_grid(t, 1e-3 * t))[700] == pytest.approx(7e-3)


def test_the_verb_prints_them_and_pools_the_bias_over_logs(tmp_path):
    rng, biases = np.random.default_rng(3), (0.01, 0.012, 0.007)
    paths = []
    for bias in biases:
        gyro = bias + 1e-3 * rng.standard_normal((1000, 3))
        paths.append(hubodo.from_arrays(gyro, rate=RATE).save(tmp_path / f"{bias}.mcap"))
    one = json.loads(run("allan", paths[0], "--also", "total,psd", "--json").out)
    assert one["other_deviations"]["total"]["tau"][0] == pytest.approx(1.0 / RATE)
    assert len(one["spectral_density"]["frequency_hz"]) == len(one["spectral_density"]["root_density"])
    page = tmp_path / "page.html"
    done = run("allan", paths[0], "--also", "hadamard,psd", "--report", page)
    assert "hadamard" in done.out and "Spectral density" in page.read_text("utf-8")
    assert run("allan", paths[0], "--also", "hadamrad").code == 2
    done = run("allan", *paths, "--units", "si")
    assert "the bias repeats within" in done.out.replace("\n", " ")
    pooled = json.loads(run("allan", *paths, "--json").out)["bias_repeatability"][0]
    assert pooled["biases"] == pytest.approx(biases, abs=2e-4)
    assert pooled["deviation"]["value"] == pytest.approx(np.std(biases, ddof=1), rel=0.05)
    assert pooled["deviation"]["sigma"] == pytest.approx(pooled["deviation"]["value"] / 2.0)
