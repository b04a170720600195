"""Codes in fields of messages, by name."""

from enum import IntEnum


class Part(IntEnum):
    """Chips that a node can detect on its bus."""

    LSM6DS33 = 1
    LIS3MDL = 2
    MPU6050 = 3
    MPU6500 = 4


class Board(IntEnum):
    """Boards, from ``sys.implementation._machine``; RP2 is any other board with such a processor."""

    OTHER = 0
    RP2 = 1
    ESP32 = 2
    PICO = 3
    PICO_W = 4
    PICO_2 = 5
    PICO_2_W = 6
    ESP32_S3 = 7
    ESP32_C3 = 8


class ResetCause(IntEnum):
    """Causes of the last start of the node. HARD: reset without power loss; SOFT: by the program itself."""

    UNKNOWN = 0
    POWER_ON = 1
    HARD = 2
    WATCHDOG = 3
    SOFT = 4
    BROWN_OUT = 5


class FilterKind(IntEnum):
    """Estimators on the node."""

    OFF = 0
    KALMAN = 1
    RLS = 2


class BiasKind(IntEnum):
    """Methods of bias initialisation.

    MEAN: mean at standstill; REST, TABLE: known rate, zero or that of a turntable; GRAVITY: gravity
    direction.
    """

    MEAN = 0
    REST = 1
    TABLE = 2
    GRAVITY = 3


class FilterState(IntEnum):
    """States of the bias filter."""

    WAITING = 0
    INITIALISING = 1
    TRACKING = 2


class Reason(IntEnum):
    """Reasons for the refusal of a request."""

    UNKNOWN_MESSAGE = 1
    BAD_VALUE = 2
    WHEEL_TURNS = 3
    NO_IMU = 4
    BUSY = 5
    NOT_STORED = 6
    WHEEL_RESTS = 7


class ConfigKey(IntEnum):
    """Settings that `SetConfig` can change."""

    NODE_ID = 1
    RATE_HZ = 2
    GYRO_RANGE_DPS = 3
    ACCEL_RANGE_G = 4
    BATCH = 5
    FILTER_KIND = 6
    GAIN_RATE_Q20 = 7
    GAIN_BIAS_Q30 = 8
    FORGETTING_Q20 = 9
    BIAS_KIND = 10
    TABLE_RATE_UDPS = 11


class RebootMode(IntEnum):
    """Modes after a `Reboot`."""

    RUN = 0
    REPL = 1


class BatchFlag(IntEnum):
    """Bits of `ImuBatch.flags`."""

    GAP_BEFORE = 1
    SATURATED = 2
    FIFO_OVERRUN = 4
    RATE_CHANGED = 8


class Fault(IntEnum):
    """Bits of `Health.faults`: current faults, and ASLEEP for a node that is parked and waits for motion."""

    IMU_MISSING = 1
    WRONG_WHO_AM_I = 2
    BUS_STUCK = 4
    IMU_SILENT = 8
    LOW_BATTERY = 16
    POLLED_TOO_FAST = 32
    ASLEEP = 64


class UpdateStatus(IntEnum):
    """States of an update; from NO_KEY on it is refused or has failed, and the old firmware stays."""

    IDLE = 0
    CHECKING = 1
    WAITING = 2
    COMPLETE = 3
    NO_KEY = 4
    CABLE_ONLY = 5
    DAMAGED = 6
    NOT_STORED = 7
    NO_OTHER = 8
