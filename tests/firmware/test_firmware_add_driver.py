"""The recipe "add a driver" of CONTRIBUTING.md, carried out in a copy with an emulated chip."""

import shutil

import numpy as np

import hubowire
from hubodo.emulator.board.settings import Clock, Flash, Host, SensorBoard
from hubodo.emulator.chips import catalogue
from hubodo.emulator.chips.imu import Imu, accel_per_lsb, rad_per_lsb
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import quantise
from hubodo.emulator.virtual_node import VirtualNode
from hubowire import messages as m
from virtual_runs import FIRMWARE, match_samples, messages_of, unique_motion

DRIVER = '''"""TOY6, a chip that does not exist: gyro and accelerometer, polled, of one range each."""

from micropython import const

from drivers.chip import Chip, find_setting

_CTRL = const(0x01)
_STATUS = const(0x02)
_OUT = const(0x10)
_RESET = const(0x80)


class TOY6(Chip):
    """The chip. fifo, wake_mg: not used, as it has neither FIFO nor motion detector."""

    PART = 0
    WHO_AM_I_REGISTER = 0x00
    WHO_AM_I = (0xA5,)
    RATES_HZ = ((100, 100000, 1), (200, 200000, 2))
    RANGES_DPS = ((2000, 70000000, 0),)
    RANGES_G = ((16, 500000, 0),)
    RESET = (_CTRL, _RESET, 100)

    def __init__(self, i2c, address=0x68, *, odr_hz=200, range_dps=2000, range_g=16, fifo=False, wake_mg=0):
        _, self.rate_mhz, code = find_setting(self.RATES_HZ, odr_hz)
        self.range_dps, self.gyro_lsb_ndps, _ = find_setting(self.RANGES_DPS, range_dps)
        self.range_g, self.accel_lsb_ng, _ = find_setting(self.RANGES_G, range_g)
        self.temperature_lsb_udegc, self.temperature_offset_udegc = 10000, 25000000
        super().__init__(i2c, address)
        self.temperature_raw = self.realigned = 0
        self.was_running = self.read(_CTRL) != 0
        self._settings = self._standing = ((_CTRL, code),)
        self._burst = bytearray(14)
        self.configure()

    def ready(self):
        """Return True if a new sample is available."""
        return self.read(_STATUS) & 1

    def read_into(self, words, at):
        """Read a sample of six words to words[at]; return 0 if there is no new one, else 1."""
        if not self.ready():
            return 0
        raw = self._burst
        self.i2c.readfrom_mem_into(self.address, _OUT, raw)
        for i in range(6):
            value = raw[2 * i] | raw[2 * i + 1] << 8
            words[at + i] = value - 65536 if value & 0x8000 else value
        self.temperature_raw = 0
        return 1
'''
CTRL, STATUS, OUT = 0x01, 0x02, 0x10
REGISTERS = {
    0x00: Register("WHO_AM_I"),
    0x75: Register("RESERVED"),
    CTRL: Register("CTRL", 0x00, 0x8F),
    STATUS: Register("STATUS"),
    **{OUT + i: Register(f"OUT_{i}") for i in range(14)},
}


class Toy6(Imu):
    """An emulated chip that samples at 100 or 200 Hz, with a flag that reading a sample clears."""

    chip_name = "toy6"

    def __init__(self, motion, specimen):
        self._sample, self._is_new = bytes(14), False
        super().__init__(motion, specimen, 0x68, REGISTERS, (0x00, 0xA5))

    def temperature_word(self, degrees):
        return quantise((degrees - 25.0) / 0.01, 1.0)

    def power_on(self, t):
        super().power_on(t)
        self.clock.stop()
        self._sample, self._is_new = bytes(14), False

    def on_register_changed(self, t, register):
        self._sync(t)
        if self.values[CTRL] & 0x80:
            self.power_on(t)
        elif self.values[CTRL]:
            self.start_sampling(t, 100.0 * self.values[CTRL], rad_per_lsb(0.07), accel_per_lsb(0.0005))

    def _sync(self, t):
        while self.clock.next_sample_time <= t:
            sample = self.clock.next_sample(t)
            if sample is None:
                return
            _, words, temperature = sample
            self._sample = bytes(words) + temperature.to_bytes(2, "little", signed=True)
            self._is_new = True

    def read_register(self, t, register):
        self._sync(t)
        if register == STATUS:
            return int(self._is_new)
        if OUT <= register < OUT + 14:
            self._is_new = False
            return self._sample[register - OUT]
        return self.values[register]


def test_a_new_driver_is_one_file_and_one_row(tmp_path, monkeypatch):
    firmware = tmp_path / "firmware"
    shutil.copytree(FIRMWARE, firmware, ignore=shutil.ignore_patterns("__pycache__"))
    (firmware / "drivers" / "toy6.py").write_text(DRIVER)
    search = firmware / "chip_search.py"
    row = '    ("drivers.mpu6050", "MPU6050", (0x68, 0x69), 0x75, ()),\n'
    text = search.read_text()
    assert row in text
    search.write_text(text.replace(row, '    ("drivers.toy6", "TOY6", (0x68, 0x69), 0x00, (0xA5,)),\n' + row))
    monkeypatch.setattr(catalogue, "IMU_CHIPS", (*catalogue.IMU_CHIPS, Toy6))
    node = VirtualNode(
        unique_motion(5),
        Flash(firmware, {"rate_hz": 200, "mag_rate_hz": 0}),
        sensors=SensorBoard("toy6", magnetometer=False),
        clock=Clock(kind="stepped", run_for=5),
        host=Host("memory"),
        own_process=False,
    )
    with node:
        node.wait(100)
        frames = hubowire.FrameDecoder().feed(node.output)
        sent = [(frame, hubowire.decode(frame.type_id, frame.payload)) for frame in frames]
        truth = node.chip.truth()
    hello = messages_of(sent, m.Hello)[-1]
    assert hello.parts == ((0x68, 0xA5, 0),) and hello.rate_mhz == 200_000
    rows = match_samples(sent, truth)
    assert len(rows) > 900 and np.all(np.diff(rows[:, 0]) == 1), "every sample arrives in order"
    assert messages_of(sent, m.Health)[-1].faults == 0
