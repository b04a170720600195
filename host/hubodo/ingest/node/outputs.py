"""Outputs of a node's decoder: measurements in SI units with device times, and messages of the node."""

from __future__ import annotations

from dataclasses import dataclass

from hubodo.arrays import Array
from hubodo.log.records import ImuBlock, ImuRun, Times
from hubowire.messages import Health, Hello, Signal

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MagSample:
    """One sample of the magnetic field, T, node axes."""

    device_ns: int
    field: Vector
    received_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class HighGBlock:
    """Samples of a second accelerometer of larger range; device_ns: (N,), accel: (N, 3) m/s², node axes."""

    device_ns: Times
    accel: Array
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
    | HighGBlock
    | TimeReplyReceived
    | HealthReceived
    | BiasFilterReport
    | SignalReceived
    | HelloReceived
    | AnswerReceived
    | WireMismatchReport
)
