"""Catalogue of the emulated IMUs and magnetometers; a new chip is one file in this folder, one line here."""

from __future__ import annotations

from typing import Protocol

from hubodo.emulator.chips.bmi088 import Bmi088
from hubodo.emulator.chips.bmi270 import Bmi270
from hubodo.emulator.chips.icm20948 import Icm20948
from hubodo.emulator.chips.icm42688 import Icm42688
from hubodo.emulator.chips.imu import Imu, Specimen
from hubodo.emulator.chips.lis3mdl import Lis3mdl
from hubodo.emulator.chips.lsm6ds33 import Lsm6ds33
from hubodo.emulator.chips.lsm6dso import Lsm6dso, Lsm6dsr
from hubodo.emulator.chips.lsm6dsv import Lsm6dsv, Lsm6dsv320x
from hubodo.emulator.chips.mmc5983ma import Mmc5983ma
from hubodo.emulator.chips.mpu6050 import Mpu6050, Mpu6500, Mpu9250
from hubodo.emulator.chips.qmc5883l import Qmc5883l
from hubodo.emulator.motion import Motion


class ImuKind(Protocol):
    """Class of an emulated IMU: its name, and its constructor with default bus address."""

    chip_name: str

    def __call__(self, motion: Motion, specimen: Specimen | None = None) -> Imu:
        """Return a chip that is moved by `motion`."""


IMU_CHIPS: tuple[ImuKind, ...] = (
    Lsm6ds33,
    Lsm6dso,
    Lsm6dsr,
    Lsm6dsv,
    Lsm6dsv320x,
    Mpu6050,
    Mpu6500,
    Mpu9250,
    Icm20948,
    Icm42688,
    Bmi270,
    Bmi088,
)


def imu_by_name(name: str) -> ImuKind:
    """Return the class of an IMU by its `chip_name`; raise ValueError if there is none."""
    for kind in IMU_CHIPS:
        if kind.chip_name == name:
            return kind
    raise ValueError(
        f"no emulated IMU {name!r}; choose from {', '.join(kind.chip_name for kind in IMU_CHIPS)}"
    )


MAG_CHIPS: dict[str, type[Lis3mdl | Qmc5883l | Mmc5983ma]] = {
    "lis3mdl": Lis3mdl,
    "qmc5883l": Qmc5883l,
    "mmc5983ma": Mmc5983ma,
}
