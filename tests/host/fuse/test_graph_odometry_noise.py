"""The graph finds how noisy an odometry is from what the fixes say of it."""

import numpy as np
import pytest

import wanted
from accuracy import car_gnss
from graph_drives import errors_of, fixes_of, make, numeric, path_of, rms
from hubodo.fuse.graph import odometry_noise
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.graph import OdometryPath, fuse_graph
from hubodo.fuse.graph.steps import StepNoise


def noisier(path, rng, along, sideways, heading):
    """A path with noise of so many m, m and rad per root of a metre in its steps."""
    place, head = path.x + 1j * path.y, np.unwrap(path.heading)
    way = np.diff(place) * np.exp(-0.5j * (head[1:] + head[:-1]))
    root = np.sqrt(np.abs(way))
    white = rng.standard_normal((3, len(way)))
    way = way + root * (along * white[0] + 1j * sideways * white[1])
    head = head[0] + np.append(0.0, np.cumsum(np.diff(head) + heading * root * white[2]))
    place = place[0] + np.append(0.0, np.cumsum(way * np.exp(0.5j * (head[1:] + head[:-1]))))
    return OdometryPath(path.t, place.real, place.imag, head)


def test_precise_fixes_tell_each_noise_apart():
    base = StepNoise(heading=0.0, heading_way=2e-3)
    wanted_noise = np.array([0.08, 0.02, 8e-3])
    found = []
    for seed in range(3):
        drive = make(seed, sigma=0.05)
        path = noisier(path_of(drive), np.random.default_rng([seed, 71]), *wanted_noise)
        noise = fuse_graph(path, fixes_of(drive, sigma=0.05), None, GraphConfig(noise=base)).noise
        found.append(np.array(noise.times) * [base.along, base.sideways, base.heading_way])
    # Of 250 m a variance of each metre's step is known to a tenth, less where noise of the fixes hides it.
    assert np.mean(found, axis=0) == pytest.approx(wanted_noise, rel=0.3)


@pytest.mark.parametrize("hours", [0.5, 3.0])
def test_the_stretches_that_are_looked_at_reach_from_the_first_fix_to_the_last(hours):
    t = np.arange(0.0, 3600.0 * hours, 2.0)
    good = np.arange(5, len(t) - 5)
    found = odometry_noise._stretches(good, t)
    assert 3 <= len(found) <= 4
    assert found[0][0] == good[0] and found[-1][-1] == good[-1]
    middles = [np.mean(t[one]) for one in found]
    # Ten minutes each, evenly apart but for one stretch.
    assert all(np.ptp(t[one]) == pytest.approx(600.0, abs=10.0) for one in found)
    assert np.ptp(np.diff(middles)) <= 600.0


def test_the_posterior_falls_as_its_derivatives_say(monkeypatch):
    seen = []
    likely = odometry_noise._most_likely
    monkeypatch.setattr(odometry_noise, "_most_likely", lambda item: seen.append(item) or likely(item))
    drive = make(4)
    fuse_graph(path_of(drive), fixes_of(drive))
    logs = np.array([1.0, -1.0, 2.0, 0.1, 3.0, -2.0])
    _, slope = odometry_noise._cost(logs, seen[0])
    assert slope == pytest.approx(
        numeric(lambda v: np.array([odometry_noise._cost(v, seen[0])[0]]), logs)[0], rel=1e-4, abs=1e-5
    )


def test_a_heading_that_strays_is_noticed_with_fixes_of_five_metres():
    honest, bold = [], []
    for seed in range(4):
        drive = make(seed)
        path = noisier(path_of(drive), np.random.default_rng([seed, 72]), 0.0, 0.0, 0.02)
        for told, config in ((honest, GraphConfig()), (bold, GraphConfig(honest=False))):
            result = fuse_graph(path, fixes_of(drive), None, config)
            error = errors_of(drive, result)
            sigma = np.column_stack([result.track.sigma_x, result.track.sigma_y])
            told.append((rms(error), np.mean(np.sum((error[:, :2] / sigma) ** 2, axis=1))))
    assert np.mean(bold, axis=0)[1] > 4.0
    assert 0.7 * 2 < np.mean(honest, axis=0)[1] < 2 * 2
    assert np.mean(honest, axis=0)[0] < np.mean(bold, axis=0)[0]


def test_on_a_real_car_with_fixes_of_five_metres_the_track_is_as_good_as_it_says():
    wanted.recording("car")
    for path, constants, truth in car_gnss.paths([("right",)]).values():
        rows = [car_gnss.one(path, constants, truth, seed, 0.0) for seed in range(3)]
        off, nees, fixes = np.mean(rows, axis=0)
        assert off < 0.7 < 0.1 * fixes
        assert nees < 4.0
