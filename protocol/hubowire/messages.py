"""The table of messages: every field that crosses the wire, with its wire type, scale and unit."""

import re
from dataclasses import MISSING, dataclass, field, fields
from enum import IntEnum
from typing import Any, ClassVar, get_args

from hubowire.codes import BatchFlag as BatchFlag
from hubowire.codes import BiasKind as BiasKind
from hubowire.codes import Board as Board
from hubowire.codes import ConfigKey as ConfigKey
from hubowire.codes import Fault as Fault
from hubowire.codes import FilterKind as FilterKind
from hubowire.codes import FilterState as FilterState
from hubowire.codes import Part as Part
from hubowire.codes import Reason as Reason
from hubowire.codes import RebootMode as RebootMode
from hubowire.codes import ResetCause as ResetCause


@dataclass(frozen=True, slots=True)
class WireField:
    """One field as the wire has it.

    type: a `struct` code with an optional repeat ("I", "3h", "8s"), or such a code followed by "[]":
        a count byte, then that many rows.
    scale, unit: value in `unit` = integer on the wire * scale; the scale is exact decimal text.
    """

    name: str
    type: str
    scale: str
    unit: str
    doc: str

    @property
    def repeats(self) -> bool:
        return self.type.endswith("[]")

    @property
    def row_type(self) -> str:
        return self.type.removesuffix("[]")


def wire(type: str, doc: str, *, scale: str = "1", unit: str = "", default: Any = MISSING) -> Any:
    """A dataclass field that knows its place on the wire; see `WireField`."""
    metadata = {"type": type, "scale": scale, "unit": unit, "doc": doc}
    if default is MISSING:
        return field(metadata=metadata)
    return field(metadata=metadata, default=default)


class Message:
    """Base of every message: integers as the wire carries them."""

    __slots__ = ()
    type_id: ClassVar[int]


def wire_fields(message: type[Message]) -> tuple[WireField, ...]:
    """The fields of a message class in wire order."""
    rows = []
    for item in fields(message):  # type: ignore[arg-type]
        meta = item.metadata
        rows.append(WireField(item.name, meta["type"], meta["scale"], meta["unit"], meta["doc"]))
    return tuple(rows)


_DEVICE_TIME = "device time, modulo 2^30"


@dataclass(frozen=True, slots=True)
class Hello(Message):
    """Who the node is. Its first seven bytes never change, so that any version can name the other."""

    type_id: ClassVar[int] = 0x01
    fingerprint: int = wire("I", "of the message table the node was built with")
    firmware: tuple[int, int, int] = wire("3B", "firmware version: major, minor, patch")
    serial: bytes = wire("8s", "unique id of the board, padded with zeros")
    boot_id: int = wire("H", "drawn anew at each start: tells a restart from a long gap")
    board: int = wire("B", "what runs the firmware: Board")
    reset_cause: int = wire("B", "ResetCause")
    rate_mhz: int = wire("I", "nominal sample rate", scale="1e-3", unit="Hz")
    gyro_range_dps: int = wire("H", "full scale of the gyro", unit="deg/s")
    accel_range_g: int = wire("B", "full scale of the accelerometer", unit="g")
    gyro_lsb_ndps: int = wire("I", "one step of the gyro", scale="1e-9", unit="deg/s")
    accel_lsb_ng: int = wire("I", "one step of the accelerometer", scale="1e-9", unit="g")
    temperature_lsb_udegc: int = wire("I", "one step of the thermometer", scale="1e-6", unit="degC")
    temperature_offset_udegc: int = wire("i", "temperature at raw 0", scale="1e-6", unit="degC")
    mag_lsb_ft: int = wire("I", "one step of the magnetometer, 0 without one", scale="1e-15", unit="T")
    batch: int = wire("B", "samples in a full ImuBatch")
    filter_kind: int = wire("B", "FilterKind")
    stamp_bound_us: int = wire(
        "H", "times of samples are known to +- this by the node's clock; 65535 = not yet", unit="us"
    )
    parts: tuple[tuple[int, ...], ...] = wire(
        "3B[]", "parts found: I2C address, WHO_AM_I, Part (0 = not known)", default=()
    )


@dataclass(frozen=True, slots=True)
class ImuBatch(Message):
    """Consecutive samples of one IMU, as the chip gave them."""

    type_id: ClassVar[int] = 0x02
    t_us: int = wire("I", _DEVICE_TIME + ", of the first sample", unit="us")
    period_ns: int = wire("I", "sample period, measured against the node's clock", unit="ns")
    index: int = wire("H", "number of the first sample since the node started, modulo 2^16")
    temperature_raw: int = wire("h", "thermometer steps; see Hello")
    flags: int = wire("B", "BatchFlag bits")
    samples: tuple[tuple[int, ...], ...] = wire(
        "6h[]", "gyro x, y, z, accelerometer x, y, z in steps; see Hello", default=()
    )


@dataclass(frozen=True, slots=True)
class Mag(Message):
    """One magnetometer sample."""

    type_id: ClassVar[int] = 0x03
    t_us: int = wire("I", _DEVICE_TIME, unit="us")
    field_raw: tuple[int, int, int] = wire("3h", "magnetic field x, y, z in steps; see Hello")


@dataclass(frozen=True, slots=True)
class Filter(Message):
    """State of the bias filter. Rate and bias are seen only as their sum: the split rests on the start."""

    type_id: ClassVar[int] = 0x04
    t_us: int = wire("I", _DEVICE_TIME + ", of the last sample used", unit="us")
    state: int = wire("B", "FilterState")
    saturations: int = wire("H", "times an intermediate was clipped, modulo 2^16")
    samples: int = wire("I", "samples behind the initial bias, 0 when it comes from the settings")
    rate_q8: tuple[int, int, int] = wire("3i", "angular rate x, y, z", scale="1/256", unit="gyro step")
    bias_q12: tuple[int, int, int] = wire(
        "3i", "bias x, y, z, warm-up included", scale="1/4096", unit="gyro step"
    )
    variance_q8: tuple[int, int, int] = wire(
        "3I", "variance of a sample at rest x, y, z", scale="1/256", unit="gyro step^2"
    )
    bias_sigma_q12: tuple[int, int, int] = wire(
        "3I",
        "1 sigma of the initial bias x, y, z, 0 = not known; what was not seen keeps that of the start",
        scale="1/4096",
        unit="gyro step",
    )


@dataclass(frozen=True, slots=True)
class Health(Message):
    """Counters since the start; each stops at its largest value."""

    type_id: ClassVar[int] = 0x05
    t_us: int = wire("I", _DEVICE_TIME, unit="us")
    battery_mv: int = wire("H", "supply voltage, 0 = not measured", unit="mV")
    faults: int = wire("H", "Fault bits: what is wrong now")
    i2c_errors: int = wire("H", "transfers that failed, and settings found changed on the chip")
    bus_recoveries: int = wire("H", "times the bus was freed with nine clocks")
    fifo_overruns: int = wire("H", "times the chip's FIFO overflowed")
    samples_missed: int = wire("H", "samples known to be missed on the chip")
    frames_dropped: int = wire("H", "frames given up because the link did not take them")
    frames_damaged: int = wire("H", "damaged frames received from the host")
    queue_high_water: int = wire("B", "most frames that waited at once")
    worst_loop_us: int = wire("I", "longest turn of the main loop since the last report", unit="us")
    reset_cause: int = wire("B", "ResetCause")
    free_heap: int = wire("I", "bytes free on the heap when sampling began", unit="B")
    stamp_bound_us: int = wire(
        "H", "times of samples are known to +- this by the node's clock; 65535 = not yet", unit="us"
    )
    battery_percent: int = wire(
        "B",
        "charge left of a lithium cell by its voltage, 255 = not known or fed from outside",
        unit="%",
        default=255,
    )


@dataclass(frozen=True, slots=True)
class Ack(Message):
    """The request was carried out."""

    type_id: ClassVar[int] = 0x06
    request: int = wire("B", "message type of the request")
    request_seq: int = wire("H", "its sequence number")


@dataclass(frozen=True, slots=True)
class Nack(Message):
    """The request was refused."""

    type_id: ClassVar[int] = 0x07
    request: int = wire("B", "message type of the request")
    request_seq: int = wire("H", "its sequence number")
    reason: int = wire("B", "Reason")
    detail: int = wire("i", "the offending value, where there is one")


@dataclass(frozen=True, slots=True)
class TimeReply(Message):
    """Answer to `TimeRequest`: with the host's own two readings, the four time stamps of a clock sync."""

    type_id: ClassVar[int] = 0x08
    token: bytes = wire("8s", "as it came in the request")
    received_us: int = wire("I", _DEVICE_TIME + ", when the request was read", unit="us")
    sent_us: int = wire("I", _DEVICE_TIME + ", when the reply was queued", unit="us")


@dataclass(frozen=True, slots=True)
class Signal(Message):
    """What a receiver has heard of one node by radio, since the receiver's start; counters wrap."""

    type_id: ClassVar[int] = 0x09
    t_us: int = wire("I", "device time of the receiver, modulo 2^30", unit="us")
    of_node: int = wire("B", "id of the node")
    frames: int = wire("I", "frames that came whole and were passed on")
    frames_lost: int = wire("I", "frames that did not come whole, by their numbers")
    pieces: int = wire("I", "packets heard")
    pieces_twice: int = wire("I", "packets that had come before")
    pieces_strong: int = wire("I", "packets heard above -64 dBm")
    rssi_dbm: int = wire("b", "strength of the newest packet, 0 = not measured", unit="dBm")
    requests_dropped: int = wire("H", "requests to the node that it did not fetch in time")


@dataclass(frozen=True, slots=True)
class TimeRequest(Message):
    """Asks for the node's clock."""

    type_id: ClassVar[int] = 0x41
    token: bytes = wire("8s", "given back unread; the host puts its send time there")


@dataclass(frozen=True, slots=True)
class Ping(Message):
    """Asks for an Ack."""

    type_id: ClassVar[int] = 0x42


@dataclass(frozen=True, slots=True)
class SetConfig(Message):
    """Changes one setting and stores it on the node; sampling settings take effect at the next Start."""

    type_id: ClassVar[int] = 0x43
    key: int = wire("B", "ConfigKey")
    value: int = wire("i", "new value, in the unit the key's name carries")


@dataclass(frozen=True, slots=True)
class Start(Message):
    """Starts sampling; a node also does so by itself after power-on."""

    type_id: ClassVar[int] = 0x44


@dataclass(frozen=True, slots=True)
class Stop(Message):
    """Stops sampling; the node goes on answering."""

    type_id: ClassVar[int] = 0x45


@dataclass(frozen=True, slots=True)
class BiasInit(Message):
    """Starts a bias initialisation as the node's BiasKind says. Answered when it has ended."""

    type_id: ClassVar[int] = 0x46
    samples: int = wire("H", "how many samples to use, at least 2000")


@dataclass(frozen=True, slots=True)
class Reboot(Message):
    """Restarts the node."""

    type_id: ClassVar[int] = 0x47
    mode: int = wire("B", "RebootMode")


@dataclass(frozen=True, slots=True)
class GetHello(Message):
    """Asks for `Hello`."""

    type_id: ClassVar[int] = 0x48


NodeMessage = Hello | ImuBatch | Mag | Filter | Health | Ack | Nack | TimeReply | Signal
HostMessage = TimeRequest | Ping | SetConfig | Start | Stop | BiasInit | Reboot | GetHello
AnyMessage = NodeMessage | HostMessage
"""What `decode` may give: a `match` over it that forgets one is found by the type checker."""

NODE_TO_HOST: tuple[type[Message], ...] = get_args(NodeMessage)
HOST_TO_NODE: tuple[type[Message], ...] = get_args(HostMessage)
MESSAGES = NODE_TO_HOST + HOST_TO_NODE
ENUMS: tuple[type[IntEnum], ...] = (
    Part,
    Board,
    ResetCause,
    FilterKind,
    BiasKind,
    FilterState,
    Reason,
    ConfigKey,
    RebootMode,
    BatchFlag,
    Fault,
)
# As the node id of a request: whoever hears it. No node has it.
ANY_NODE = 0
NODE_NAMES = {1: "left", 2: "right", 3: "frame", 200: "receiver"}
NODE_IDS = {name: number for number, name in NODE_NAMES.items()}


def node_name(node_id: int) -> str:
    """The name of a node id: left, right, frame, else ``node<id>``."""
    return NODE_NAMES.get(node_id, f"node{node_id}")


def upper_snake(class_name: str) -> str:
    """``ImuBatch`` to ``IMU_BATCH``: what a class is called in constants and, in lower case, in files."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", class_name).upper()
