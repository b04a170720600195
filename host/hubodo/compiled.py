"""Loops over samples that no array operation can replace: in machine code once that pays, where numba is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PAYS = 1_000_000
"""Samples after which a loop is compiled. Importing numba and fetching the code that it kept takes half a
second (a second or two the very first time), as long as the plain loop takes for about as many samples."""

State = TypeVar("State")


class Loop(Generic[State]):
    """A function `body(samples, made, state, *constants) -> state` that reads samples[i] and writes made[i],
    i rising, and the functions of plain numbers (helpers) that it calls.

    Without numba, or before it pays, the same source runs as Python on lists. The bits are the same: numba
    neither reorders nor fuses what it compiles.
    """

    def __init__(self, body: Callable[..., State], *helpers: Callable[..., Any]) -> None:
        self._body, self._helpers = body, helpers
        self._code: Callable[..., State] | None = None
        self._worked = 0

    @property
    def compiled(self) -> bool:
        """Whether it has become machine code."""
        return self._code is not None

    def __call__(self, samples: Array, made: Array, state: State, *constants: float | bool) -> State:
        """samples: (N,), writeable and contiguous, as numba compiles anew for every other kind; made: (N,),
        overwritten. Returns the state after the last sample."""
        if self._code is None and self._worked < PAYS <= self._worked + len(samples):
            self._code = _machine_code(self._body, self._helpers)
        self._worked += len(samples)
        if self._code is not None:
            return self._code(samples, made, state, *constants)
        values = made.tolist()
        state = self._body(samples.tolist(), values, state, *constants)
        made[:] = values
        return state


def _machine_code(
    body: Callable[..., State], helpers: tuple[Callable[..., Any], ...]
) -> Callable[..., State] | None:
    try:
        import numba
        from numba.extending import register_jitable
    except ImportError:
        return None
    for helper in helpers:
        register_jitable(helper)
    code: Callable[..., State] = numba.njit(cache=True)(body)
    return code
