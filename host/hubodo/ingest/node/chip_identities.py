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
    0x47: ImuChip("ICM42688", 2.8, 70.0),
    0xEA: ImuChip("ICM20948", 15.0, 230.0),
    0x24: ImuChip("BMI270", 7.0, 160.0),
    0x0F: ImuChip("BMI088", 14.0, 175.0),
}
"""Chips by WHO_AM_I, without a code of their own in `Part`, which is part of the wire format."""

MAG_BY_IDENTITY = {
    (0x0D, 0xFF): "QMC5883L",
    (0x30, 0x30): "MMC5983MA",
    (0x0C, 0x09): "AK09916",
    (0x0C, 0x48): "AK8963",
}
"""Magnetometers by address and identity."""

HIGH_G_BY_IDENTITY = {(0x53, 0xE5): "ADXL375", (0x1D, 0xE5): "ADXL375"}
"""Second accelerometers by address and identity."""
