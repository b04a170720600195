"""A fake I2C bus with an IMU, a LIS3MDL and an ADXL375 that allocates nothing: enough to feed the sampling.

Sample k, counted from the first read on, is (k % 32, -(k % 32), k % 7, -(k % 5), 700, 1900). For an LSM6DS33
on a turning wheel it is (k % 32, -(k % 32), SPIN + k % 7, ax, ay, 0): gravity turns once in 1000 samples.
"""

import math
import struct
import time
from array import array

SPIN = 1094
"""One turn in 1000 samples of 4700 us, in steps of 0.07 deg/s."""


class FakeBus:
    """A bus that answers only at its two addresses; period_us: sample period; imu: name of a driver file."""

    def __init__(self, imu, period_us, spins=False):
        self.imu = imu
        self.spins = spins
        self.gravity = array("h", bytes(400))
        for i in range(100 if spins else 0):
            self.gravity[2 * i] = round(2049 * math.cos(0.02 * math.pi * i))
            self.gravity[2 * i + 1] = round(-2049 * math.sin(0.02 * math.pi * i))
        self.has_high_g = False
        self.high_g_us = 0
        self.is_st = imu in ("lsm6ds33", "lsm6dso", "lsm6dsv")
        self.address = 0x6B if self.is_st else 0x68
        self.period_us = period_us
        self.registers = {}
        self.read = 0
        self.flagged = 0
        self.taken = 0
        self.since_us = 0
        self.made = 0

    def samples(self):
        now = time.ticks_us()
        new = time.ticks_diff(now, self.since_us) // self.period_us
        if new:
            self.since_us = time.ticks_add(self.since_us, new * self.period_us)
            self.made += new
        return self.made

    def writeto(self, address, buffer):
        if address != self.address and address != 0x1E and (address != 0x53 or not self.has_high_g):
            raise OSError(5)

    def writeto_mem(self, address, register, buffer):
        self.writeto(address, buffer)
        value = buffer[0]
        if address == self.address:
            if self.is_st and register == 0x12:
                value &= ~0x81
            elif self.imu == "mpu6050" and register == 0x6B:
                value &= ~0x80
            if (self.is_st and register == 0x0A) or (self.imu == "mpu6050" and register == 0x6A):
                self.read = self.samples()
        self.registers[address << 8 | register] = value

    def readfrom_mem_into(self, address, register, buffer):
        time.run(60 + 23 * len(buffer))
        if address == 0x1E:
            self._magnetometer(register, buffer)
        elif address == 0x53 and self.has_high_g:
            self._adxl375(register, buffer)
        elif address != self.address:
            raise OSError(5)
        elif self.imu == "lsm6ds33":
            self._lsm6ds33(register, buffer)
        elif self.imu == "lsm6dso":
            self._tagged(register, buffer, 0x6C, 0x3A, 4000)
        elif self.imu == "lsm6dsv":
            self._tagged(register, buffer, 0x70, 0x1B, 4608)
        else:
            self._mpu6050(register, buffer)

    def _magnetometer(self, register, buffer):
        if register == 0x0F:
            buffer[0] = 0x3D
        elif register == 0x27:
            buffer[0] = 0x08
        elif register == 0xA8:
            for i in range(6):
                buffer[i] = i + 1
        else:
            buffer[0] = self.registers[address_of(0x1E, register)]

    def _adxl375(self, register, buffer):
        """A FIFO of 32 samples at 400 Hz."""
        if register == 0x00:
            buffer[0] = 0xE5
        elif register == 0x39:
            waiting = time.ticks_diff(time.ticks_us(), self.high_g_us) // 2500
            if waiting > 32:
                self.high_g_us = time.ticks_add(self.high_g_us, (waiting - 32) * 2500)
            buffer[0] = min(waiting, 32)
        elif register == 0x32:
            self.high_g_us = time.ticks_add(self.high_g_us, 2500)
            for i in range(6):
                buffer[i] = i + 1
        else:
            buffer[0] = self.registers[address_of(0x53, register)]

    def _lsm6ds33(self, register, buffer):
        if register == 0x0F:
            buffer[0] = 0x69
        elif register == 0x1E:
            new = self.samples() > self.read
            buffer[0] = 0x07 if new else 0
            if len(buffer) == 16:
                buffer[2], buffer[3] = 0x34, 0x12
                if new:
                    self._sample(buffer, 4, 0)
                    self.read = self.made
        elif register == 0x20:
            buffer[0], buffer[1] = 0x34, 0x12
        elif register == 0x3A:
            words = 6 * (self.samples() - self.read)
            buffer[0], buffer[1] = words & 0xFF, words >> 8
            if len(buffer) == 4:
                buffer[2], buffer[3] = 0, 0
        elif register == 0x3E:
            for at in range(0, len(buffer), 12):
                self._sample(buffer, at, 0)
                self.read += 1
        else:
            buffer[0] = self.registers.get(address_of(self.address, register), 0)

    def _tagged(self, register, buffer, identity, status, ticks_per_100_ms):
        """Three tagged words per sample: gyro, accelerometer, time stamp."""
        if register == 0x0F:
            buffer[0] = identity
        elif register == status:
            words = 3 * (self.samples() - self.read)
            buffer[0], buffer[1] = words & 0xFF, words >> 8
        elif register == 0x78:
            for at in range(0, len(buffer), 21):
                tag = (self.read & 3) << 1
                ticks = self.read * (self.period_us * ticks_per_100_ms // 100000)
                self._sample(buffer, at + 1, 7)
                for i in range(3):
                    buffer[at + 7 * i] = (1 << i) << 3 | tag
                buffer[at + 15], buffer[at + 16] = ticks & 0xFF, ticks >> 8 & 0xFF
                self.read += 1
        else:
            self._lsm6ds33(register, buffer)

    def _mpu6050(self, register, buffer):
        if register == 0x75:
            buffer[0] = 0x68
        elif register == 0x3A:
            # Reading the flag clears it; the FIFO continues.
            buffer[0] = 1 if self.samples() > self.flagged else 0
            self.flagged = self.made
            if len(buffer) == 15:
                self._sample(buffer, 1, 8)
                buffer[7], buffer[8] = 0x12, 0x34
        elif register == 0x41:
            buffer[0], buffer[1] = 0x12, 0x34
        elif register == 0x72:
            count = 12 * (self.samples() - self.read)
            buffer[0], buffer[1] = count >> 8, count & 0xFF
        elif register == 0x74:
            for at in range(0, len(buffer), 12):
                self._sample(buffer, at, 6)
                self.read += 1
        else:
            buffer[0] = self.registers.get(address_of(self.address, register), 0)

    def _sample(self, buffer, at, gyro_after):
        """Write a sample as the chip does: gyro first, little-endian; or accelerometer first, big-endian."""
        k = self.taken
        self.taken += 1
        if self.spins:
            i = k // 10 % 100 * 2
            ax, ay = self.gravity[i], self.gravity[i + 1]
            struct.pack_into("<6h", buffer, at, k & 31, -(k & 31), SPIN + k % 7, ax, ay, 0)
        elif gyro_after and self.is_st:
            struct.pack_into("<3h", buffer, at, k & 31, -(k & 31), k % 7)
            struct.pack_into("<3h", buffer, at + gyro_after, -(k % 5), 700, 1900)
        elif gyro_after:
            struct.pack_into(">3h", buffer, at, -(k % 5), 700, 1900)
            struct.pack_into(">3h", buffer, at + gyro_after, k & 31, -(k & 31), k % 7)
        else:
            struct.pack_into("<6h", buffer, at, k & 31, -(k & 31), k % 7, -(k % 5), 700, 1900)


def address_of(address, register):
    return address << 8 | register
