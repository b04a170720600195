"""A banked road, put into simulated readings by code that does not know the effect."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from gap_matrix import cases
from gap_matrix.recording import write_case_files
from gap_matrix.world import GRAVITY
from gap_runs import run_gap
from hubodo.effects import BY_NAME
from hubodo.effects.sensor_chain import SensorChain
from hubodo.gap.scatter.road_bank import _log_likelihoods
from repetitions import first_and_more


def draw_bank(distance, sigma, length, seed):
    """Return a bank, rad, at distances, m: filtered noise on a grid of half a metre."""
    rng = np.random.default_rng(seed)
    grid = np.arange(0.0, distance[-1] + 1.0, 0.5)
    kernel = np.exp(-np.arange(0.0, 8.0 * length, 0.5) / length)
    white = rng.standard_normal(len(grid) + len(kernel) - 1)
    bank = np.convolve(white, kernel, "valid") / np.sqrt(np.sum(kernel**2))
    return np.interp(distance, grid, sigma * bank)


@pytest.mark.parametrize("seed", first_and_more(32, 31))
def test_a_banked_road_is_named_with_its_size_and_nothing_else(seed, tmp_path):
    sigma, length = 0.03, 15.0
    setup = cases.draw_setup(seed, duration=60.0, vibration=0.0)
    setup = cases.resample_nodes(setup, 30.0, np.random.default_rng(seed))
    motion = setup.drive.motion
    distance = np.cumsum(np.abs(motion.speed)) * motion.step
    bank = draw_bank(distance, sigma, length, seed)
    records = {}
    for node in ("left", "right"):
        times = setup.sample_times[node]
        added = np.zeros((len(times), 6))
        side = 1.0 if setup.facing[node] == "left" else -1.0
        added[:, 5] = side * GRAVITY * np.sin(np.interp(times, motion.t, bank))
        records[node] = cases.simulate_node_record(setup, node, [], added)
    write_case_files(setup, [], tmp_path / "log", {}, records)
    run = run_gap(tmp_path / "out", tmp_path / "log" / "model.toml", tmp_path / "log")
    assert run.names == [("road_bank", "vehicle")], run.out
    (finding,) = run.result["found"]
    assert finding["of_this_drive"] is True
    estimate = finding["parameters"]["sigma"]
    print(f"seed {seed}: bank {np.std(bank):.4f} rad, estimated {estimate['value']:.4f}")
    assert abs(estimate["value"] - np.std(bank)) < max(3.0 * estimate["sigma"], 0.25 * np.std(bank))
    assert run.result["gap"]["after"] < 1.03 < run.result["gap"]["before"]


def test_the_simulated_road_has_the_variance_and_the_correlation_that_it_declares():
    t = np.arange(0.0, 2000.0, 0.05)
    zero = np.zeros((3, len(t)))
    chain = SensorChain(t, t, zero, zero, zero, zero.copy(), zero.copy(), speed=np.full(len(t), 5.0))
    BY_NAME["road_bank"](sigma=0.02, length=20.0).add_random_walk(chain, np.random.default_rng(1))
    bank = np.arcsin(chain.accel[1] / 9.80665)
    assert np.std(bank) == pytest.approx(0.02, rel=0.1)
    lag = int(20.0 / 5.0 / 0.05)
    assert np.mean(bank[lag:] * bank[:-lag]) / np.var(bank) == pytest.approx(np.exp(-1.0), abs=0.1)


def test_the_likelihood_of_a_bank_is_that_of_a_process_of_the_distance_with_standstills():
    """Against the joint distribution of all windows; the readings are quiet while the vehicle stands."""
    rng = np.random.default_rng(1)
    speed = np.repeat([0.0, 3.0, 0.0, 6.0], 15)
    distances, variance = 0.5 * speed, np.where(speed > 0.0, 4e-4, 6e-5) ** 2
    sigma, length = 2e-3, 20.0
    place = np.cumsum(distances)
    shape = np.exp(-np.abs(place[:, None] - place) / length)
    bank = rng.multivariate_normal(np.zeros(len(place)), sigma**2 * shape + np.diag(variance))
    # The distance of a window is driven before the next one.
    gaps = np.append(np.diff(place), 0.0)
    likelihoods = _log_likelihoods(
        bank, variance, gaps, np.array([[sigma, length], [2.0 * sigma, 3.0 * length]])
    )
    covariances = [sigma**2 * shape, 4.0 * sigma**2 * shape ** (1.0 / 3.0)]
    exact = [multivariate_normal(cov=part + np.diag(variance)).logpdf(bank) for part in covariances]
    assert likelihoods[1] - likelihoods[0] == pytest.approx(exact[1] - exact[0], abs=1e-3)
