"""Loops in machine code: the same bits as in Python, from when they pay, and without numba not at all."""

import sys

import numpy as np
import pytest

from hubodo import compiled
from hubodo.compiled import Loop
from hubodo.fuse.filters import recursive_least_squares
from hubodo.fuse.filters.recursive_least_squares import RecursiveLeastSquares

COUNT = 5000


def rough(seed):
    """Samples in which a bit that is lost stays lost: a walk, noise, and stretches of equal values."""
    rng = np.random.default_rng(seed)
    z = np.cumsum(rng.normal(0.0, 0.1, COUNT)) + rng.normal(0.0, 1e-3, COUNT)
    z[1000:2000] = z[1000]
    return z


def fresh(monkeypatch, pays):
    """The loop of RLS as a new process has it."""
    monkeypatch.setattr(compiled, "PAYS", pays)
    loop = Loop(recursive_least_squares._run, recursive_least_squares._step)
    monkeypatch.setattr(recursive_least_squares, "LOOP", loop)
    return loop


@pytest.mark.parametrize("lagged", [False, True])
def test_machine_code_gives_the_bits_of_python(monkeypatch, lagged):
    pytest.importorskip("numba")
    z, loop = rough(3), fresh(monkeypatch, 1)
    batch, live = (RecursiveLeastSquares(0.98, bias=0.01, lagged=lagged) for _ in range(2))
    rates = np.concatenate([batch.run(z[:1234]), batch.run(z[1234:])])
    assert loop.compiled
    assert rates.tolist() == [live.update(value) for value in z.tolist()]
    assert batch.coefficients == live.coefficients
    assert np.array_equal(batch.spread, live.spread)
    assert batch.update(0.5) == live.update(0.5)


def test_a_loop_is_compiled_once_it_has_worked_as_many_samples_as_pay(monkeypatch):
    pytest.importorskip("numba")
    loop = fresh(monkeypatch, COUNT)
    for count, expected in ((COUNT - 1, False), (1, True), (1, True)):
        RecursiveLeastSquares(0.98).run(np.ones(count))
        assert loop.compiled is expected


def test_without_numba_the_same_source_runs_as_python(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    z, loop = rough(4), fresh(monkeypatch, 1)
    live = RecursiveLeastSquares(0.98)
    assert RecursiveLeastSquares(0.98).run(z).tolist() == [live.update(value) for value in z.tolist()]
    assert not loop.compiled
