"""Chips that a node reports without a `Part`: name by identity, and of IMUs the data-sheet noise."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ImuChip:
    """An IMU: name, and one-sided noise densities of its data sheet in mdeg/s/√Hz and µg/√Hz."""

    name: str
    gyro_density: float
    accel_density: float


IMU_BY_WHO_AM_I = {
    0x6C: ImuChip("LSM6DSO", 3.8, 70.0),
    0x6B: ImuChip("LSM6DSR", 5.0, 60.0),
    0x70: ImuChip("LSM6DSV", 2.8, 60.0),
    0x73: ImuChip("LSM6DSV320X", 2.8, 60.0),
    0x47: ImuChip("ICM42688", 2.8, 70.0),
    0xEA: ImuChip("ICM20948", 15.0, 230.0),
    0x24: ImuChip("BMI270", 7.0, 160.0),
    0x0F: ImuChip("BMI088", 14.0, 175.0),
}
"""Chips by WHO_AM_I, without a code of their own in `Part`, which is part of the wire format."""

_SHARED_IDENTITIES = (0x70, 0x73)
"""Of LSM6DSV and LSM6DSV320X, at 0x6A and 0x6B, and of MPU-6500 and MPU-9255, at 0x68 and 0x69."""


def imu_chip(address: int, who_am_i: int) -> ImuChip | None:
    """Return the IMU with this identity, without a `Part`; None if it is unknown."""
    if who_am_i in _SHARED_IDENTITIES and address not in (0x6A, 0x6B):
        return None
    return IMU_BY_WHO_AM_I.get(who_am_i)


MAG_BY_IDENTITY = {
    (0x0D, 0xFF): "QMC5883L",
    (0x30, 0x30): "MMC5983MA",
    (0x0C, 0x09): "AK09916",
    (0x0C, 0x48): "AK8963",
}
"""Magnetometers by address and identity."""

HIGH_G_BY_IDENTITY = {(0x53, 0xE5): "ADXL375", (0x1D, 0xE5): "ADXL375"}
"""Second accelerometers by address and identity."""
