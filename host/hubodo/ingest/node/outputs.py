"""Outputs of a node's decoder: measurements in SI units with device times, and messages of the node."""

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

    device_ns: (N,) unwrapped device time. gyro: (N, 3) rad/s; accel: (N, 3) m/s² specific force, node axes.
    temperature: °C. raw: (N, 6) int16 as on the wire. received_ns: host time of arrival.
    """

    device_ns: NDArray[np.int64]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]
    temperature: float
    raw: NDArray[np.int16]
    received_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class ImuRun:
    """Consecutive blocks of one node as one; gaps between them are reported separately.

    device_ns, gyro, accel, raw: all N samples, as in `ImuBlock`. first_rows: (B,) first sample of each block;
    temperature: (B,) °C; received_ns: (B,).
    """

    device_ns: NDArray[np.int64]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]
    raw: NDArray[np.int16]
    first_rows: NDArray[np.int64]
    temperature: NDArray[np.float64]
    received_ns: NDArray[np.int64]

    def split(self) -> Iterator[ImuBlock]:
        """Yield the blocks one by one."""
        edges = [*self.first_rows.tolist(), len(self.device_ns)]
        block_values = zip(self.temperature.tolist(), self.received_ns.tolist(), strict=True)
        for (start, end), (temperature, received_ns) in zip(pairwise(edges), block_values, strict=True):
            rows = slice(start, end)
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
    """One sample of the magnetic field, T, node axes."""

    device_ns: int
    field: Vector
    received_ns: int


@dataclass(frozen=True, slots=True)
class HelloReceived:
    """The Hello of a node; restarted: True for a new boot of a node identified before."""

    hello: Hello
    restarted: bool
    received_ns: int


@dataclass(frozen=True, slots=True)
class TimeReplyReceived:
    """A node's reply to a clock request, with both time stamps unwrapped."""

    token: bytes
    received_us: int
    sent_us: int
    arrived_ns: int


@dataclass(frozen=True, slots=True)
class HealthReceived:
    """A health report of a node: counters and supply."""

    health: Health
    device_ns: int
    received_ns: int


@dataclass(frozen=True, slots=True)
class SignalReceived:
    """A radio receiver's report about one node."""

    signal: Signal
    device_ns: int
    received_ns: int


@dataclass(frozen=True, slots=True)
class BiasFilterReport:
    """Output of the node's own bias filter: angular rate and bias, rad/s, node axes.

    Attributes
    ----------
    state
        FilterState.
    samples
        Number of samples behind the initial bias; 0 if the bias is from the settings.
    noise
        Standard deviation of a sample at standstill.
    bias_sigma
        Standard deviation of the initial bias; NaN where unknown.
    saturations
        Number of clipped intermediate results, modulo 2^16.
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
class AnswerReceived:
    """A node's answer to a request; reason: None if it was carried out, else the `Reason` of the refusal."""

    request: int
    request_seq: int
    reason: int | None
    received_ns: int


@dataclass(frozen=True, slots=True)
class WireMismatchReport:
    """Report of a node built from another message table; its frames are logged raw and not decoded."""

    text: str
    received_ns: int


NodeOutput = (
    ImuBlock
    | ImuRun
    | MagSample
    | TimeReplyReceived
    | HealthReceived
    | BiasFilterReport
    | SignalReceived
    | HelloReceived
    | AnswerReceived
    | WireMismatchReport
)
