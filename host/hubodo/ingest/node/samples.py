"""What a node's frames become: measurements in SI units with device times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hubowire.messages import Health, Hello, Signal

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class ImuBlock:
    """Consecutive samples of one node.

    device_ns: (N,) device time on the unbroken scale. gyro: (N, 3) rad/s; accel: (N, 3) m/s2 specific
    force, node axes. temperature: degC. raw: (N, 6) int16 as on the wire. received_ns: host time of arrival.
    """

    device_ns: NDArray[np.int64]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]
    temperature: float
    raw: NDArray[np.int16]
    received_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class ImuRun:
    """Blocks of one node that follow each other, as one; what is missing between them is told apart.

    device_ns, gyro, accel, raw: of all N samples, as of `ImuBlock`. first: (B,) the first sample of each
    block; temperature: (B,) degC; received_ns: (B,).
    """

    device_ns: NDArray[np.int64]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]
    raw: NDArray[np.int16]
    first: NDArray[np.int64]
    temperature: NDArray[np.float64]
    received_ns: NDArray[np.int64]

    def blocks(self) -> Iterator[ImuBlock]:
        """The blocks one by one."""
        edges = [*self.first.tolist(), len(self.device_ns)]
        told = zip(self.temperature.tolist(), self.received_ns.tolist(), strict=True)
        for (begin, end), (temperature, received_ns) in zip(pairwise(edges), told, strict=True):
            rows = slice(begin, end)
            yield ImuBlock(
                self.device_ns[rows],
                self.gyro[rows],
                self.accel[rows],
                temperature,
                self.raw[rows],
                received_ns,
            )


@dataclass(frozen=True, slots=True)
class MagSample:
    """One magnetic field, tesla, node axes."""

    device_ns: int
    field: Vector
    received_ns: int


@dataclass(frozen=True, slots=True)
class HelloSeen:
    """A node has said who it is; `restarted` when it is a new start of a node known before."""

    hello: Hello
    restarted: bool
    received_ns: int


@dataclass(frozen=True, slots=True)
class TimeReplySeen:
    """A node's answer to a clock request, its two stamps on the unbroken scale."""

    token: bytes
    received_us: int
    sent_us: int
    arrived_ns: int


@dataclass(frozen=True, slots=True)
class HealthSeen:
    """A node's counters, and its supply."""

    health: Health
    device_ns: int
    received_ns: int


@dataclass(frozen=True, slots=True)
class SignalSeen:
    """What a receiver has heard of one node."""

    signal: Signal
    device_ns: int
    received_ns: int


@dataclass(frozen=True, slots=True)
class FilterSeen:
    """What the node's own filter makes of its gyro: angular rate and bias, rad/s, node axes.

    state: FilterState. samples: behind the initial bias, 0 when it comes from the settings. noise: 1 sigma of
    a sample at rest; bias_sigma: 1 sigma of the initial bias, NaN where it is not known. saturations: times
    an intermediate was clipped, modulo 2^16.
    """

    device_ns: int
    state: int
    samples: int
    rate: Vector
    bias: Vector
    noise: Vector
    bias_sigma: Vector
    saturations: int
    received_ns: int


@dataclass(frozen=True, slots=True)
class AnswerSeen:
    """A node has done what the request of that type and number asked, or refused it: reason, a `Reason`."""

    request: int
    request_seq: int
    reason: int | None
    received_ns: int


@dataclass(frozen=True, slots=True)
class Refused:
    """A node built from another message table; its frames are kept raw and not decoded."""

    text: str
    received_ns: int


Sample = (
    ImuBlock
    | ImuRun
    | MagSample
    | TimeReplySeen
    | HealthSeen
    | FilterSeen
    | SignalSeen
    | HelloSeen
    | AnswerSeen
    | Refused
)
