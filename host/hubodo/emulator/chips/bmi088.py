"""Emulated BMI088: a gyro and an accelerometer with addresses, registers, FIFOs and clocks of their own."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.emulator.chips.bosch import BoschChip
from hubodo.emulator.chips.faults import BrownOut
from hubodo.emulator.chips.imu import Imu, Specimen, accel_per_lsb, rad_per_lsb
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import RawWords, SampleClock, quantise
from hubodo.emulator.motion import Motion

CHIP_ID, SOFT_RESET = 0x00, 0xB6
STATUS, ACC_OUT, SENSORTIME, TEMP_MSB, TEMP_LSB = 0x03, 0x12, 0x18, 0x22, 0x23
FIFO_LENGTH_0, FIFO_LENGTH_1, ACC_FIFO_DATA, ACC_CONF, ACC_RANGE = 0x24, 0x25, 0x26, 0x40, 0x41
ACC_FIFO_CONFIG_0, ACC_FIFO_CONFIG_1, ACC_PWR_CONF, ACC_PWR_CTRL, ACC_CMD = 0x48, 0x49, 0x7C, 0x7D, 0x7E
ACC_ODR_HZ = {5: 12.5, 6: 25.0, 7: 50.0, 8: 100.0, 9: 200.0, 10: 400.0, 11: 800.0, 12: 1600.0}
ACC_RANGE_G = (3.0, 6.0, 12.0, 24.0)
ACC_FIFO_BYTES, FRAME_BYTES = 1024, 7
_DATA_HEADER, _SKIP_HEADER = 0x84, 0x40
_DRDY, _FIFO_FLUSH, _IN_FIFO, _ON = 0x80, 0xB0, 0x40, 0x04

RATE, FIFO_STATUS, RANGE, BANDWIDTH, LPM1, SOFTRESET = 0x02, 0x0E, 0x0F, 0x10, 0x11, 0x14
FIFO_CONFIG_1, FIFO_DATA = 0x3E, 0x3F
GYRO_ODR_HZ = (2000.0, 2000.0, 1000.0, 400.0, 200.0, 100.0, 200.0, 100.0)
GYRO_RANGE_DPS = (2000.0, 1000.0, 500.0, 250.0, 125.0)
GYRO_FIFO_FRAMES, GYRO_FRAME_BYTES = 100, 6
_OVERRUN, _BYPASS, _STREAM = 0x80, 0, 2

ACCELEROMETER_REGISTERS: dict[int, Register] = {
    CHIP_ID: Register("ACC_CHIP_ID"),
    0x02: Register("ACC_ERR_REG"),
    STATUS: Register("ACC_STATUS"),
    **{ACC_OUT + i: Register(f"ACC_OUT_{i}") for i in range(6)},
    **{SENSORTIME + i: Register(f"SENSORTIME_{i}") for i in range(3)},
    0x1D: Register("ACC_INT_STAT_1"),
    TEMP_MSB: Register("TEMP_MSB"),
    TEMP_LSB: Register("TEMP_LSB"),
    FIFO_LENGTH_0: Register("FIFO_LENGTH_0"),
    FIFO_LENGTH_1: Register("FIFO_LENGTH_1"),
    ACC_FIFO_DATA: Register("FIFO_DATA"),
    ACC_CONF: Register("ACC_CONF", 0xA8, 0xFF),
    ACC_RANGE: Register("ACC_RANGE", 0x01, 0x03),
    0x45: Register("FIFO_DOWNS", 0x80, 0xF0),
    0x46: Register("FIFO_WTM_0", 0x02, 0xFF),
    0x47: Register("FIFO_WTM_1", 0x00, 0x1F),
    ACC_FIFO_CONFIG_0: Register("FIFO_CONFIG_0", 0x02, 0x03),
    ACC_FIFO_CONFIG_1: Register("FIFO_CONFIG_1", 0x10, 0x5C),
    ACC_PWR_CONF: Register("ACC_PWR_CONF", 0x03, 0xFF),
    ACC_PWR_CTRL: Register("ACC_PWR_CTRL", 0x00, 0xFF),
    ACC_CMD: Register("ACC_SOFTRESET", 0x00, 0xFF),
}

GYRO_REGISTERS: dict[int, Register] = {
    CHIP_ID: Register("GYRO_CHIP_ID"),
    **{RATE + i: Register(f"RATE_{i}") for i in range(6)},
    0x0A: Register("GYRO_INT_STAT_1"),
    FIFO_STATUS: Register("FIFO_STATUS"),
    RANGE: Register("GYRO_RANGE", 0x00, 0x07),
    BANDWIDTH: Register("GYRO_BANDWIDTH", 0x80, 0x07),
    LPM1: Register("GYRO_LPM1", 0x00, 0xA0),
    SOFTRESET: Register("GYRO_SOFTRESET", 0x00, 0xFF),
    0x15: Register("GYRO_INT_CTRL", 0x00, 0xC0),
    0x16: Register("INT3_INT4_IO_CONF", 0x0F, 0x0F),
    0x18: Register("INT3_INT4_IO_MAP", 0x00, 0xA5),
    0x1E: Register("FIFO_WM_ENABLE", 0x00, 0x88),
    0x3D: Register("FIFO_CONFIG_0", 0x00, 0x7F),
    FIFO_CONFIG_1: Register("FIFO_CONFIG_1", 0x00, 0xC0),
    FIFO_DATA: Register("FIFO_DATA"),
    0x75: Register("RESERVED"),
}


class Bmi088Accelerometer(BoschChip):
    """The accelerometer of a BMI088: suspended and off after a reset, with headers in its FIFO.

    Its clock deviates from the nominal rate by the specimen's error with the opposite sign, so that it and
    the gyro drift apart. Not modelled: FIFO frames of time and settings, watermarks, down-sampling.
    """

    OUTPUT, OUTPUT_BYTES, FIFO_REGISTER = ACC_OUT, 6, ACC_FIFO_DATA

    def __init__(self, motion: Motion, specimen: Specimen, address: int) -> None:
        self._motion, self._specimen = motion, specimen
        self._rng = np.random.default_rng([specimen.seed, 1])
        self._temperature = 0
        self.clock = SampleClock(
            3,
            odr_error=-specimen.odr_error,
            odr_per_degree=specimen.odr_per_degree,
            temperature=motion.temperature,
            temperature_word=lambda degrees: quantise((degrees - 23.0) * 8.0, 1.0),
        )
        faults = tuple(fault for fault in specimen.faults if isinstance(fault, BrownOut))
        super().__init__(
            "imu", address, ACCELEROMETER_REGISTERS, (CHIP_ID, 0x1E), faults, strict=specimen.strict
        )

    def power_on(self, t: float) -> None:
        """Reset the registers at t, as power-up and soft reset do."""
        super().power_on(t)
        self.clock.stop()
        self._clear_fifo()

    def _clear_fifo(self) -> None:
        self._fifo.clear()
        self._skipped_frames = self._part_bytes = 0
        self._skip_frame = b""

    @property
    def lsb(self) -> float:
        """Resolution at the current range, m/s² per LSB."""
        return accel_per_lsb(ACC_RANGE_G[self.values[ACC_RANGE] & 3] / 32768)

    def on_register_changed(self, t: float, register: int) -> None:
        """React to a control register that changed."""
        self.measure_until(t)
        if register == ACC_CMD:
            command, self.values[ACC_CMD] = self.values[ACC_CMD], 0
            if command == SOFT_RESET:
                self.power_on(t)
            elif command == _FIFO_FLUSH:
                self._clear_fifo()
        elif register in (ACC_CONF, ACC_RANGE, ACC_PWR_CONF, ACC_PWR_CTRL):
            self._configure(t)

    def _configure(self, t: float) -> None:
        """Restart sampling with the current settings, or stop it while the sensor is off."""
        self.clock.stop()
        rate_hz = ACC_ODR_HZ.get(self.values[ACC_CONF] & 15)
        if self.values[ACC_PWR_CONF] or self.values[ACC_PWR_CTRL] != _ON:
            return
        if rate_hz is None:
            self._count_anomaly("invalid rate in", ACC_CONF)
            return
        lsb = self.lsb

        def measure(times: Array) -> RawWords:
            accel = self._motion.specific_force(times)
            if self._specimen.disturbance is not None:
                rate = self._motion.angular_rate(times)
                _, accel = self._specimen.disturbance(times, rate, accel, self._rng)
            return quantise(accel, lsb)

        self.clock.start(t, rate_hz, measure, np.full(3, lsb))

    def measure_until(self, t: float) -> None:
        """Measure the samples due by t, and store them in the FIFO."""
        for sample in self.clock.samples_until(t):
            _, self._sample, self._temperature = sample
            self._data_ready = _DRDY
            if self.values[ACC_FIFO_CONFIG_1] & _IN_FIFO:
                self._fifo += bytes([_DATA_HEADER]) + self._sample
                if len(self._fifo) > ACC_FIFO_BYTES:
                    oldest = FRAME_BYTES if self._part_bytes else 0  # a frame that is being read stays
                    del self._fifo[oldest : oldest + FRAME_BYTES]
                    self._skipped_frames += 1

    def set_pointer(self, sub_address: int) -> None:
        """Receive the sub-address byte; a frame that was read in part stays in the FIFO."""
        super().set_pointer(sub_address)
        self._part_bytes, self._skip_frame = 0, b""

    def read_fifo(self, n: int) -> bytes:
        """Return up to n bytes of the FIFO, and remove its whole frames."""
        if self._skipped_frames and not self._part_bytes:
            self._skip_frame = bytes([_SKIP_HEADER, min(self._skipped_frames, 255)])
            self._skipped_frames = 0
        skip, self._skip_frame = self._skip_frame[:n], self._skip_frame[n:]
        data = bytes(self._fifo[self._part_bytes :][: n - len(skip)])
        self._part_bytes += len(data)
        n_frames, self._part_bytes = divmod(self._part_bytes, FRAME_BYTES)
        del self._fifo[: n_frames * FRAME_BYTES]
        return skip + data

    def read_register(self, t: float, register: int) -> int:
        """Return one byte, and apply the side effects of the read."""
        self.measure_until(t)
        if register == STATUS:
            return self._data_ready
        if register in (TEMP_MSB, TEMP_LSB):
            return (self._temperature << 5).to_bytes(2, "big", signed=True)[register - TEMP_MSB]
        if register in (FIFO_LENGTH_0, FIFO_LENGTH_1):
            return len(self._fifo) >> 8 * (register - FIFO_LENGTH_0) & 0xFF
        if SENSORTIME <= register < SENSORTIME + 3:
            return int(t / 39.0625e-6) >> 8 * (register - SENSORTIME) & 0xFF
        return self.values[register]


class Bmi088(BoschChip, Imu):
    """A BMI088 that is moved by `motion`: its gyro, with the accelerometer at an address of its own.

    Register maps and formulas: Bosch BST-BMI088-DS001. Samples are those of the gyro; `truth` pairs each with
    the acceleration at its time, which the accelerometer has sampled up to a period earlier or later. Not
    modelled: filters, interrupts, the synchronisation by an uploaded program.
    """

    chip_name = "bmi088"
    OUTPUT, OUTPUT_BYTES, FIFO_REGISTER = RATE, 6, FIFO_DATA

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x68) -> None:
        specimen = specimen or Specimen()
        self.accelerometer = Bmi088Accelerometer(motion, specimen, address - 0x50)
        self.companions = (self.accelerometer,)
        super().__init__(motion, specimen, address, GYRO_REGISTERS, (CHIP_ID, specimen.who_am_i or 0x0F))

    def temperature_word(self, degrees: Array) -> RawWords:
        """Return temperature words of the accelerometer, which has the thermometer: 8 LSB/°C, 0 at 23 °C."""
        return quantise((degrees - 23.0) * 8.0, 1.0)

    def power_on(self, t: float) -> None:
        """Reset the registers at t, as power-up and soft reset do; the gyro then runs."""
        super().power_on(t)
        self._clear_fifo()
        self._configure(t)

    def _clear_fifo(self) -> None:
        self._fifo.clear()
        self._has_overrun = False

    @property
    def gyro_lsb(self) -> float:
        """Resolution of the gyro at the current range, rad/s per LSB."""
        return rad_per_lsb(GYRO_RANGE_DPS[min(self.values[RANGE], 4)] / 32768)

    def on_register_changed(self, t: float, register: int) -> None:
        """React to a control register that changed."""
        self.measure_until(t)
        if register == SOFTRESET:
            command, self.values[SOFTRESET] = self.values[SOFTRESET], 0
            if command == SOFT_RESET:
                self.power_on(t)
        elif register in (RANGE, BANDWIDTH, LPM1):
            self._configure(t)
        elif register == FIFO_CONFIG_1:
            self._clear_fifo()

    def _configure(self, t: float) -> None:
        """Restart sampling with the current settings, or stop it in a suspend mode."""
        self.clock.stop()
        if not self.values[LPM1]:
            rate_hz = GYRO_ODR_HZ[self.values[BANDWIDTH] & 7]
            self.start_sampling(t, rate_hz, self.gyro_lsb, self.accelerometer.lsb)

    def measure_until(self, t: float) -> None:
        """Measure the samples due by t, and store them in the FIFO."""
        for sample in self.clock.samples_until(t):
            self._sample = sample[1][:6]
            mode = self.values[FIFO_CONFIG_1] >> 6
            if mode == _BYPASS:
                self._fifo.clear()
            part = len(self._fifo) % GYRO_FRAME_BYTES  # the rest of a frame that is being read
            self._fifo += self._sample
            if self._frames_held() > (GYRO_FIFO_FRAMES if mode != _BYPASS else 1):
                self._has_overrun = True
                oldest = part if mode == _STREAM else len(self._fifo) - GYRO_FRAME_BYTES
                del self._fifo[oldest : oldest + GYRO_FRAME_BYTES]
                self.fifo_dropped += 6

    def _frames_held(self) -> int:
        return -(-len(self._fifo) // GYRO_FRAME_BYTES)

    def set_pointer(self, sub_address: int) -> None:
        """Receive the sub-address byte; the rest of a frame that was read in part is lost."""
        super().set_pointer(sub_address)
        del self._fifo[: len(self._fifo) % GYRO_FRAME_BYTES]

    def read_register(self, t: float, register: int) -> int:
        """Return one byte."""
        self.measure_until(t)
        if register == FIFO_STATUS:
            return self._frames_held() | (_OVERRUN if self._has_overrun else 0)
        return self.values[register]
