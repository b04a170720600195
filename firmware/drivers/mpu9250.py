"""MPU-6500, MPU-9250 and MPU-9255: an MPU-6050 with half of its FIFO, another thermometer (InvenSense).

The magnetometer of an MPU-9250 is a chip of its own on an inner bus, which is connected to the outer one.
"""

from micropython import const
from wire import PART_MPU6500

from drivers.mpu6050 import MPU6050

_ACCEL_CONFIG_2 = const(0x1D)
_INT_PIN_CFG = const(0x37)

_BYPASS = const(0x02)


class MPU9250(MPU6050):
    """Settings are those of MPU6050. PART is that of the MPU-6500, the same chip without magnetometer."""

    PART = PART_MPU6500
    WHO_AM_I = (0x70, 0x71, 0x73)
    FIFO_BYTES = 512
    FIFO_SAMPLES = 42
    """Capacity of the FIFO in whole samples."""
    CLONES = False
    TEMPERATURE = (2995, 21000000)

    def _more_settings(self, low_pass):
        """Return the low-pass of the accelerometer and the connection of the two buses."""
        return ((_ACCEL_CONFIG_2, low_pass), (_INT_PIN_CFG, _BYPASS))
