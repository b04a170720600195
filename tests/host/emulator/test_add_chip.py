"""The recipe "add an emulated chip" of the emulator's README, carried out in a copy of the package."""

import re
from pathlib import Path

from package_copy import ROOT, PackageCopy

CHIP = '''"""A made-up IMU with an identity register and one output byte."""

from hubodo.emulator.chips.imu import Imu, Specimen, accel_per_lsb, rad_per_lsb
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import quantise


class MadeUp(Imu):
    """A made-up IMU at 100 Hz."""

    chip_name = "made_up"

    def __init__(self, motion, specimen=None, *, address=0x55):
        self.accel_z = 0
        registers = {0x00: Register("WHO_AM_I"), 0x01: Register("CONTROL", 0, 1), 0x02: Register("ACCEL_Z")}
        super().__init__(motion, specimen or Specimen(), address, registers, (0x00, 0xA5))

    def temperature_word(self, degrees):
        return quantise(degrees, 1.0)

    def on_register_changed(self, t, register):
        self.start_sampling(t, 100.0, rad_per_lsb(1.0), accel_per_lsb(0.1))

    def read_register(self, t, register):
        while (sample := self.clock.next_sample(t)) is not None:
            self.accel_z = sample[1][10]
        return self.accel_z if register == 0x02 else self.values[register]
'''
MAIN = """
import time
from machine import I2C, Pin
bus = I2C(0, scl=Pin(5), sda=Pin(4))
bus.writeto_mem(0x55, 1, b"\\x01")
time.sleep_ms(50)
print("found", bus.scan(), bus.readfrom_mem(0x55, 0, 1), bus.readfrom_mem(0x55, 2, 1))
"""
RUN = """
import sys
from pathlib import Path
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
node = VirtualNode(
    StillMotion(), Flash(Path(sys.argv[1])), sensors=SensorBoard("made_up", magnetometer=False),
    board=BoardSettings(interpreter="cpython"), clock=Clock("stepped", run_for=1.0), host=Host("memory"),
)
with node:
    node.wait(60)
    print(node.output.decode(), len(node.chip.truth().t))
"""


def test_a_new_chip_is_one_file_and_one_line(tmp_path: Path):
    copy = PackageCopy(tmp_path)
    (copy.package / "emulator" / "chips" / "made_up.py").write_text(CHIP)
    copy.replace(
        "emulator/chips/catalogue.py",
        ("    Bmi088,\n)", "    Bmi088,\n    MadeUp,\n)"),
        ("\n\nclass ImuKind", "from hubodo.emulator.chips.made_up import MadeUp\n\n\nclass ImuKind"),
    )
    firmware = tmp_path / "firmware"
    firmware.mkdir()
    (firmware / "main.py").write_text(MAIN)

    # 1 g is 10 LSB of 0.1 g.
    output = copy.run("-c", RUN, firmware)
    assert "found [85] b'\\xa5' b'\\n'" in output
    assert int(output.split()[-1]) >= 4
    assert "made_up" in copy.run("-m", "hubodo.emulator", "--help")


def test_registers_of_a_chip_occur_only_in_its_driver_and_emulation():
    pattern = re.compile(
        r"\b(CTRL1_XL|CTRL2_G|FIFO_CTRL\d|WAKE_UP_(?:SRC|THS|DUR)|MD1_CFG|PWR_MGMT_1|SMPLRT_DIV)\b"
    )
    allowed = ("firmware/drivers/", "host/hubodo/emulator/chips/")
    files = [
        path.relative_to(ROOT).as_posix()
        for folder in ("firmware", "host/hubodo")
        for path in sorted((ROOT / folder).rglob("*.py"))
        if pattern.search(path.read_text("utf-8"))
    ]
    assert {name for name in files if name.startswith("firmware/drivers/")}
    assert [name for name in files if not name.startswith(allowed)] == []
