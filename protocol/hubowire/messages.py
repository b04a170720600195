"""The message table: every message and field on the wire, with type, scale and unit.

A new message is one dataclass here, named in `NodeMessage` or `HostMessage`; then run `tools/gen_wire.py`.
"""

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
from hubowire.codes import UpdateStatus as UpdateStatus


@dataclass(frozen=True, slots=True)
class WireField:
    """A field of a message on the wire.

    Attributes
    ----------
    name : name of the field; the unit of the integer, where it is not SI, is part of it.
    type : `struct` code with optional repeat ("I", "3h", "8s"); followed by "[]", a table: a count byte, then
        that many rows of the code.
    scale, unit : value in `unit` = integer on the wire times scale; the scale is exact decimal text.
    doc : meaning, for the tables of README.md; not covered by the fingerprint.
    """

    name: str
    type: str
    scale: str
    unit: str
    doc: str

    @property
    def is_table(self) -> bool:
        """True for a counted table of rows."""
        return self.type.endswith("[]")

    @property
    def row_type(self) -> str:
        """`struct` code of the field, or of one row of a table."""
        return self.type.removesuffix("[]")


def declare_field(type: str, doc: str, *, scale: str = "1", unit: str = "", default: Any = MISSING) -> Any:
    """Declare a field of a message, as a field of its dataclass.

    Parameters
    ----------
    type, doc, scale, unit : see `WireField`.
    default : value of the dataclass field.
    """
    metadata = {"type": type, "scale": scale, "unit": unit, "doc": doc}
    if default is MISSING:
        return field(metadata=metadata)
    return field(metadata=metadata, default=default)


class Message:
    """Base class of all messages; their fields hold the integers on the wire."""

    __slots__ = ()
    type_id: ClassVar[int]


def wire_fields(message: type[Message]) -> tuple[WireField, ...]:
    """Return the fields of a message class in the order of the wire."""
    rows = []
    for item in fields(message):  # type: ignore[arg-type]
        meta = item.metadata
        rows.append(WireField(item.name, meta["type"], meta["scale"], meta["unit"], meta["doc"]))
    return tuple(rows)


_DEVICE_TIME = "device time, modulo 2^30"


@dataclass(frozen=True, slots=True)
class Hello(Message):
    """Identification of the node.

    Its first seven bytes never change, so that every version can identify any other.
    """

    type_id: ClassVar[int] = 0x01
    fingerprint: int = declare_field("I", "fingerprint of the message table of the node")
    firmware: tuple[int, int, int] = declare_field("3B", "firmware version: major, minor, patch")
    serial: bytes = declare_field("8s", "unique id of the board, padded with zeros")
    boot_id: int = declare_field("H", "random number of each start: distinguishes a restart from a long gap")
    board: int = declare_field("B", "board that runs the firmware: Board")
    reset_cause: int = declare_field("B", "ResetCause")
    rate_mhz: int = declare_field("I", "nominal sample rate", scale="1e-3", unit="Hz")
    gyro_range_dps: int = declare_field("H", "full scale of the gyro", unit="deg/s")
    accel_range_g: int = declare_field("B", "full scale of the accelerometer", unit="g")
    gyro_lsb_ndps: int = declare_field("I", "one step of the gyro", scale="1e-9", unit="deg/s")
    accel_lsb_ng: int = declare_field("I", "one step of the accelerometer", scale="1e-9", unit="g")
    temperature_lsb_udegc: int = declare_field("I", "one step of the thermometer", scale="1e-6", unit="degC")
    temperature_offset_udegc: int = declare_field("i", "temperature at raw 0", scale="1e-6", unit="degC")
    mag_lsb_ft: int = declare_field(
        "I", "one step of the magnetometer, 0 without one", scale="1e-15", unit="T"
    )
    batch: int = declare_field("B", "samples in a full ImuBatch")
    filter_kind: int = declare_field("B", "FilterKind")
    stamp_bound_us: int = declare_field(
        "H", "bound on the error of sample times in the node clock; 65535 = unknown", unit="us"
    )
    parts: tuple[tuple[int, ...], ...] = declare_field(
        "3B[]", "chips: I2C address (0 = on SPI), WHO_AM_I, Part (0 = unknown)", default=()
    )


@dataclass(frozen=True, slots=True)
class ImuBatch(Message):
    """Consecutive raw samples of one IMU."""

    type_id: ClassVar[int] = 0x02
    t_us: int = declare_field("I", _DEVICE_TIME + ", of the first sample", unit="us")
    period_ns: int = declare_field("I", "sample period, measured with the node clock", unit="ns")
    index: int = declare_field("H", "number of the first sample since the node started, modulo 2^16")
    temperature_raw: int = declare_field("h", "thermometer steps; see Hello")
    flags: int = declare_field("B", "BatchFlag bits")
    samples: tuple[tuple[int, ...], ...] = declare_field(
        "6h[]", "gyro x, y, z, accelerometer x, y, z in steps; see Hello", default=()
    )


@dataclass(frozen=True, slots=True)
class Mag(Message):
    """One magnetometer sample."""

    type_id: ClassVar[int] = 0x03
    t_us: int = declare_field("I", _DEVICE_TIME, unit="us")
    field_raw: tuple[int, int, int] = declare_field("3h", "magnetic field x, y, z in steps; see Hello")


@dataclass(frozen=True, slots=True)
class Filter(Message):
    """State of the bias filter.

    Only the sum of rate and bias is observable: the initial bias determines the split.
    """

    type_id: ClassVar[int] = 0x04
    t_us: int = declare_field("I", _DEVICE_TIME + ", of the last sample used", unit="us")
    state: int = declare_field("B", "FilterState")
    saturations: int = declare_field("H", "times an intermediate was clipped, modulo 2^16")
    samples: int = declare_field("I", "samples used for the initial bias, 0 if it comes from the settings")
    rate_q8: tuple[int, int, int] = declare_field(
        "3i", "angular rate x, y, z", scale="1/256", unit="gyro step"
    )
    bias_q12: tuple[int, int, int] = declare_field(
        "3i", "bias x, y, z, warm-up included", scale="1/4096", unit="gyro step"
    )
    variance_q8: tuple[int, int, int] = declare_field(
        "3I", "variance of a sample at standstill x, y, z", scale="1/256", unit="gyro step^2"
    )
    bias_sigma_q12: tuple[int, int, int] = declare_field(
        "3I",
        "1 sigma of the initial bias x, y, z, 0 = unknown; an unobserved axis keeps its prior",
        scale="1/4096",
        unit="gyro step",
    )


@dataclass(frozen=True, slots=True)
class Health(Message):
    """Counters since the start of the node; each saturates at its largest value."""

    type_id: ClassVar[int] = 0x05
    t_us: int = declare_field("I", _DEVICE_TIME, unit="us")
    battery_mv: int = declare_field("H", "supply voltage, 0 = not measured", unit="mV")
    faults: int = declare_field("H", "Fault bits: current faults")
    i2c_errors: int = declare_field("H", "failed transfers, and settings that changed on the chip")
    bus_recoveries: int = declare_field("H", "bus recoveries with nine clock pulses")
    fifo_overruns: int = declare_field("H", "overflows of the FIFO of the chip")
    samples_missed: int = declare_field("H", "samples known to be lost on the chip")
    frames_dropped: int = declare_field("H", "frames discarded because the link did not accept them")
    frames_damaged: int = declare_field("H", "damaged frames received from the host")
    queue_high_water: int = declare_field("B", "largest number of queued frames")
    worst_loop_us: int = declare_field(
        "I", "longest iteration of the main loop since the last report", unit="us"
    )
    reset_cause: int = declare_field("B", "ResetCause")
    free_heap: int = declare_field("I", "free bytes on the heap at the start of sampling", unit="B")
    stamp_bound_us: int = declare_field(
        "H", "bound on the error of sample times in the node clock; 65535 = unknown", unit="us"
    )
    battery_percent: int = declare_field(
        "B",
        "state of charge of a lithium cell by its voltage, 255 = unknown or external supply",
        unit="%",
        default=255,
    )


@dataclass(frozen=True, slots=True)
class Ack(Message):
    """A request was executed."""

    type_id: ClassVar[int] = 0x06
    request: int = declare_field("B", "message type of the request")
    request_seq: int = declare_field("H", "its sequence number")


@dataclass(frozen=True, slots=True)
class Nack(Message):
    """A request was refused."""

    type_id: ClassVar[int] = 0x07
    request: int = declare_field("B", "message type of the request")
    request_seq: int = declare_field("H", "its sequence number")
    reason: int = declare_field("B", "Reason")
    detail: int = declare_field("i", "invalid value, if there is one")


@dataclass(frozen=True, slots=True)
class TimeReply(Message):
    """Reply to `TimeRequest`; with two readings of the host clock, four time stamps of a clock sync."""

    type_id: ClassVar[int] = 0x08
    token: bytes = declare_field("8s", "token of the request")
    received_us: int = declare_field("I", _DEVICE_TIME + ", when the request was read", unit="us")
    sent_us: int = declare_field("I", _DEVICE_TIME + ", when the reply was queued", unit="us")


@dataclass(frozen=True, slots=True)
class Signal(Message):
    """Reception of one node by a radio receiver since the start of the receiver; counters wrap."""

    type_id: ClassVar[int] = 0x09
    t_us: int = declare_field("I", "device time of the receiver, modulo 2^30", unit="us")
    of_node: int = declare_field("B", "id of the node")
    frames: int = declare_field("I", "complete frames, forwarded")
    frames_lost: int = declare_field("I", "incomplete frames, by their numbers")
    pieces: int = declare_field("I", "received packets")
    pieces_twice: int = declare_field("I", "duplicate packets")
    pieces_strong: int = declare_field("I", "packets received above -64 dBm")
    rssi_dbm: int = declare_field("b", "signal strength of the last packet, 0 = not measured", unit="dBm")
    requests_dropped: int = declare_field("H", "requests that the node did not fetch in time")


@dataclass(frozen=True, slots=True)
class HighG(Message):
    """Consecutive samples of an accelerometer with a range beyond that of the IMU."""

    type_id: ClassVar[int] = 0x0A
    t_us: int = declare_field("I", _DEVICE_TIME + ", of the last sample", unit="us")
    period_ns: int = declare_field("I", "sample period, measured with the node clock", unit="ns")
    lsb_ng: int = declare_field("I", "one step", scale="1e-9", unit="g")
    samples: tuple[tuple[int, ...], ...] = declare_field("3h[]", "acceleration x, y, z in steps", default=())


@dataclass(frozen=True, slots=True)
class UpdateState(Message):
    """Progress of an update of the firmware. The three messages of an update are the same in all versions."""

    type_id: ClassVar[int] = 0x0B
    status: int = declare_field("B", "UpdateStatus")
    slot: int = declare_field("B", "slot that does not run: 0 is /fw_a, 1 is /fw_b")
    mpy: int = declare_field("H", "sys.implementation._mpy of the node: version and processor of its files")
    file: int = declare_field("H", "number of the file that is checked or awaited; 0 is the list of files")
    offset: int = declare_field("I", "offset of the awaited piece in the file", unit="B")


@dataclass(frozen=True, slots=True)
class TimeRequest(Message):
    """Request of the time of the node clock."""

    type_id: ClassVar[int] = 0x41
    token: bytes = declare_field("8s", "returned unchanged; the host stores its send time in it")


@dataclass(frozen=True, slots=True)
class Ping(Message):
    """Request of an Ack."""

    type_id: ClassVar[int] = 0x42


@dataclass(frozen=True, slots=True)
class SetConfig(Message):
    """Change of one setting, stored on the node; sampling settings take effect at the next Start."""

    type_id: ClassVar[int] = 0x43
    key: int = declare_field("B", "ConfigKey")
    value: int = declare_field("i", "new value, in the unit of the name of the key")


@dataclass(frozen=True, slots=True)
class Start(Message):
    """Start of sampling; a node also starts by itself after power-on."""

    type_id: ClassVar[int] = 0x44


@dataclass(frozen=True, slots=True)
class Stop(Message):
    """Stop of sampling; the node still replies to requests."""

    type_id: ClassVar[int] = 0x45


@dataclass(frozen=True, slots=True)
class BiasInit(Message):
    """Start of a bias initialisation of the node's BiasKind. The reply follows at its end."""

    type_id: ClassVar[int] = 0x46
    samples: int = declare_field("H", "number of samples, at least 2000")


@dataclass(frozen=True, slots=True)
class Reboot(Message):
    """Restart of the node."""

    type_id: ClassVar[int] = 0x47
    mode: int = declare_field("B", "RebootMode")


@dataclass(frozen=True, slots=True)
class GetHello(Message):
    """Request of a `Hello`."""

    type_id: ClassVar[int] = 0x48


@dataclass(frozen=True, slots=True)
class UpdateStart(Message):
    """Start or continuation of an update of the firmware, answered by UpdateState."""

    type_id: ClassVar[int] = 0x49
    slot: int = declare_field("B", "slot to write: the one that does not run; otherwise only a query")
    size: int = declare_field(
        "I",
        "size of the list of files; 0: only a query; 2^32 - 1: start the firmware in `slot` as it is",
        unit="B",
    )
    digest: bytes = declare_field("32s", "SHA-256 of the list of files")


UPDATE_START_SELECT = 2**32 - 1
"""Size in an UpdateStart that starts the firmware in its slot as it is."""


@dataclass(frozen=True, slots=True)
class UpdatePiece(Message):
    """A piece of a file, answered by UpdateState; ignored unless it is the awaited one."""

    type_id: ClassVar[int] = 0x4A
    file: int = declare_field("H", "number of the file, 0 is the list of files")
    offset: int = declare_field("I", "offset in the file", unit="B")
    data: tuple[tuple[int, ...], ...] = declare_field("1B[]", "bytes of the file", default=())


NodeMessage = Hello | ImuBatch | Mag | Filter | Health | Ack | Nack | TimeReply | Signal | HighG | UpdateState
HostMessage = (
    TimeRequest | Ping | SetConfig | Start | Stop | BiasInit | Reboot | GetHello | UpdateStart | UpdatePiece
)
AnyMessage = NodeMessage | HostMessage
"""Union of all messages that `decode` returns, so that the type checker verifies an exhaustive `match`."""

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
    UpdateStatus,
)
ANY_NODE = 0
"""Node id of a request to any node that receives it; no node has this id."""
NODE_NAMES = {1: "left", 2: "right", 3: "frame", 200: "receiver"}
NODE_IDS = {name: number for number, name in NODE_NAMES.items()}


def node_name(node_id: int) -> str:
    """Return the name of a node id: left, right, frame, receiver, or ``node<id>``."""
    return NODE_NAMES.get(node_id, f"node{node_id}")


def upper_snake(class_name: str) -> str:
    """Convert ``ImuBatch`` to ``IMU_BATCH``, the form in constants and, in lower case, in file names."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", class_name).upper()
