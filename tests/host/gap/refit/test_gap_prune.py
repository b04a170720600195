"""Backward elimination of coordinates against the loss of a Gaussian without them, and their values."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.refit.prune import _eliminate, _freeze, _with_doubt_of_pruned
from hubodo.gap.state.terms import ModelTerm
from hubodo.model.model_file import read_model
from vehicles import model_toml


def draw_fit(seed):
    """Return covariance and value of four correlated coordinates."""
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((12, 4))
    return np.linalg.inv(half.T @ half), rng.standard_normal(4)


def compute_loss(covariance, value, pruned):
    """Return the loss in ln likelihood with some coordinates at zero and the others fitted again."""
    block = covariance[np.ix_(pruned, pruned)]
    return 0.5 * value[pruned] @ np.linalg.solve(block, value[pruned])


@pytest.mark.parametrize("seed", range(4))
def test_the_loss_is_that_of_the_pruned_coordinates_together(seed):
    covariance, value = draw_fit(seed)
    pruned, loss = _eliminate(range(4), (), covariance, value, np.full(4, 1e6))
    assert sorted(pruned) == [0, 1, 2, 3]
    assert loss == pytest.approx(compute_loss(covariance, value, [0, 1, 2, 3]), rel=1e-9)


def test_an_implausible_coordinate_is_pruned_at_any_cost_and_its_loss_counts():
    covariance, value = np.eye(2), np.array([100.0, 3.0])
    assert _eliminate((0, 1), {0}, covariance, value, np.zeros(2)) == ([0], pytest.approx(5000.0))
    # It leaves the budget to the others.
    assert _eliminate((0, 1), {0}, covariance, value, np.full(2, 5.0)) == ([0, 1], pytest.approx(5004.5))


def test_each_coordinate_has_the_budget_of_its_own_channels():
    """A bias that an even channel shows stays, although one in an uneven channel costs more."""
    covariance, value = np.eye(3), np.array([4.0, 6.0, 2.0])
    pruned, loss = _eliminate(range(3), (), covariance, value, np.array([3.0, 40.0, 3.0]))
    assert sorted(pruned) == [1, 2]
    assert loss == pytest.approx(20.0)


def test_a_pruned_coordinate_of_one_node_returns_to_the_value_of_all_nodes_in_the_model_file(tmp_path):
    path = tmp_path / "car.toml"
    path.write_text(model_toml() + "[effects.gyro_scale_factor]\nx = -0.06\nz = -0.005\n", "utf-8")
    state = SimpleNamespace(problem=SimpleNamespace(model=read_model(path)))
    fit = SimpleNamespace(state=state, coordinate_slice=lambda term: slice(0, 3))
    term = ModelTerm(BY_NAME["gyro_scale_factor"](x=0.02, y=0.01, z=-0.0045), "right")
    pruned = _freeze(term, fit, {0, 1})
    assert pruned.effect.values() == pytest.approx({"x": -0.06, "y": 0.0, "z": -0.0045})
    assert pruned.frozen == (0, 1)


@dataclass(frozen=True)
class Fit:
    covariance: np.ndarray
    robust_covariance: np.ndarray


@pytest.mark.parametrize("seed", range(4))
def test_a_coordinate_is_no_better_known_because_another_one_was_pruned(seed):
    """The covariance with the others frozen, plus their doubt, is that of all coordinates free."""
    covariance, _value = draw_fit(seed)
    free, pruned = [0, 3], [1, 2]
    frozen = np.zeros((4, 4))
    frozen[np.ix_(free, free)] = np.linalg.inv(np.linalg.inv(covariance)[np.ix_(free, free)])
    fit = Fit(covariance, 4.0 * covariance)
    result = _with_doubt_of_pruned(Fit(frozen, 4.0 * frozen), fit, pruned)
    expected = np.zeros((4, 4))
    expected[np.ix_(free, free)] = covariance[np.ix_(free, free)]
    np.testing.assert_allclose(result.covariance, expected, atol=1e-12)
    np.testing.assert_allclose(result.robust_covariance, 4.0 * expected, atol=1e-12)
