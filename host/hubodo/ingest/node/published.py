"""Samples of a node as they went into the log, and the order of their log times over all nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.ingest.node.samples import ImuBlock


@dataclass(frozen=True, slots=True, eq=False)
class Published:
    """Samples of a node as they went into the log; t_ns: (N,) host time of measurement; power_on_ns: host
    time at which the node was switched on."""

    node: str
    t_ns: NDArray[np.int64]
    block: ImuBlock
    power_on_ns: int | None


class ArrivalOrder:
    """Log times of blocks of samples: strictly increasing over all nodes of a recorder.

    A log read by log time then gives the blocks in the order in which the recorder took them, which is that
    of arrival but for what was held back and for links that were read at the same moment.
    """

    def __init__(self) -> None:
        self._last_ns = 0

    def stamp(self, received_ns: int) -> int:
        """The log time of a block received at that time."""
        self._last_ns = max(received_ns, self._last_ns + 1)
        return self._last_ns
