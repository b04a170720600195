"""Print how long a battery lasts: share of time awake on an emulated Pico, and currents of data sheets.

    python tests/chip/power.py [--seconds 3] [--settings default,104] [--awake 0.26]

Awake: not waiting for an event. A Pico that waits keeps its clocks; parked (`park_after_s`) it is in
`machine.lightsleep`, while its IMU samples at 26 Hz, and wakes up for a report every 4 s.
"""

import argparse
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

SETTINGS = {
    "default": {},
    "104": {"rate_hz": 104},
    "208": {"rate_hz": 208},
    "833": {"rate_hz": 833},
    "parked": {"rate_hz": 26, "fifo": False, "mag_rate_hz": 0},
}
"""parked: as `rest_after_s` sets it."""


@dataclass(frozen=True)
class Load:
    """A load: current, mA, at `volts`, and its source. supplied: True behind the Pico's regulator."""

    name: str
    milliamps: float
    volts: float
    source: str
    supplied: bool = False


AWAKE = Load("Pico, computing", 26.0, 5.0, "assumed: 5 mA more than waiting")
WAITING = Load("Pico, waiting for an event", 21.0, 5.0, "measured, micropython issue 8770")
ASLEEP = Load("Pico, machine.lightsleep(ms)", 0.99, 5.0, "measured, micropython pull request 8832")
IMUS = (
    Load("LSM6DS33", 1.25, 3.3, "ST DocID026899, both, high performance", True),
    Load("LSM6DSO", 0.55, 3.3, "ST DS12140, both, high performance", True),
    Load("ICM-42688-P", 0.88, 3.3, "TDK DS-000347, both, low noise", True),
    Load("BMI270", 0.685, 3.3, "Bosch BST-BMI270-DS000, both", True),
    Load("MPU-6050", 3.8, 3.3, "InvenSense PS-MPU-6000A, both", True),
)
IMU_ASLEEP = Load("LSM6DSO, asleep", 0.55, 3.3, "upper bound: ST DS12140, both, high performance", True)
"""The low-power modes of both sensors at 26 Hz, in which the chip is then, take less."""
REPORT_S, REPORT_INTERVAL_S = 0.008, 4.0
"""Time awake for a report of a node that is asleep, and the interval of these.

4.9 ms on an emulated Pico (`--report`); assumed: 2 ms until a UART has sent it, 1 ms until the clocks run.
"""


@dataclass(frozen=True)
class ParkedBoard:
    """A board that parks: its loads asleep and awake, and how often it wakes up to read the motion detector.

    polls_hz: 0 where the wire from INT1 ends the sleep. is_linear: its regulator passes the sensor's current.
    """

    asleep: Load
    awake: Load
    polls_hz: float = 0.0
    is_linear: bool = True


POLL_S = 0.002
"""Time awake for a read of the detector, with the start of the clocks: assumed."""
PARKED_BOARDS = (
    ParkedBoard(ASLEEP, AWAKE, is_linear=False),
    ParkedBoard(
        Load(
            "XIAO ESP32-S3, lightsleep",
            0.54,
            3.8,
            "chip: Espressif, 0.24 mA; board: measured, 0.3 mA, topic 284207",
        ),
        Load("XIAO ESP32-S3, computing", 45.0, 3.8, "assumed: Espressif, modem-sleep at 160 MHz and more"),
    ),
    ParkedBoard(
        Load(
            "XIAO ESP32-C3, lightsleep",
            0.18,
            3.8,
            "chip: Espressif, 0.13 mA; board: measured, 0.05 mA, topic 284207",
        ),
        Load("XIAO ESP32-C3, computing", 25.0, 3.8, "assumed: Espressif, modem-sleep at 160 MHz"),
        polls_hz=10.0,
    ),
)
"""Topic 284207 of forum.seeedstudio.com measured whole boards in deep sleep, at the pads of the battery."""
MAGNETOMETER = Load("LIS3MDL", 0.27, 3.3, "ST DocID024204, ultra-high performance at 20 Hz", True)
RADIO = Load(
    "nRF24L01+, sending a tenth of the time",
    1.15,
    3.3,
    "specification 1.0: 11.3 mA at 0 dBm, 26 µA in standby",
    True,
)
REGULATOR = 0.85
"""Assumed efficiency of the Pico's regulator at some 10 mA."""
USABLE = 0.9
"""Share of a cell's charge above the node's limit of 3.3 V, in the cold and when aged: assumed."""
CELL_VOLTS = 3.6
CELLS = {"18650, 3 Ah": 3.0, "500 mAh": 0.5}
DRIVING_H = 2.0


def milliwatts(load: Load) -> float:
    """Return the power of a load at the cell; a board's figure includes its regulator."""
    return load.milliamps * load.volts / (REGULATOR if load.supplied else 1.0)


def node_milliwatts(awake: float, *loads: Load) -> float:
    """Return the power of a Pico that computes for the share `awake` of the time, and of the other loads."""
    board = awake * milliwatts(AWAKE) + (1.0 - awake) * milliwatts(WAITING)
    return board + sum(map(milliwatts, loads))


def parked_milliwatts(board: ParkedBoard) -> float:
    """Return the power of a parked node: asleep but for reports and polls; radio and magnetometer are off."""
    share = REPORT_S / REPORT_INTERVAL_S + board.polls_hz * POLL_S
    imu = IMU_ASLEEP.milliamps * CELL_VOLTS if board.is_linear else milliwatts(IMU_ASLEEP)
    return share * milliwatts(board.awake) + (1.0 - share) * milliwatts(board.asleep) + imu


def hours(amp_hours: float, power: float) -> float:
    """Return the hours that a cell lasts at a power in mW."""
    return amp_hours * CELL_VOLTS * USABLE * 1000.0 / power


def daily_mean(driving: float, parked: float) -> float:
    """Return the mean power of a day with DRIVING_H hours of driving, mW."""
    return (DRIVING_H * driving + (24.0 - DRIVING_H) * parked) / 24.0


def measure(names: list[str], seconds: float, seed: int) -> dict[str, float]:
    """Return the share of time awake of each of SETTINGS, on an emulated Pico; raise ImageMissing."""
    from chip_run import run_chip

    from chip import flashed
    from hubodo.emulator.interpreters.rp2040.image import find_image
    from hubodo.emulator.interpreters.rp2040.pico import PicoSettings

    image = find_image(None, None)
    pico = PicoSettings(image.firmware, image.bootrom)
    with tempfile.TemporaryDirectory() as scratch:
        firmware = Path(scratch) / "flash"
        flashed(firmware, pico)
        return {
            name: 1.0 - run_chip(name, SETTINGS[name], firmware, seconds, seed=seed, pico=pico).cpu_left
            for name in names
        }


def measure_report(chip: str, seed: int) -> float:
    """Return the time, s, for which an emulated Pico computes for a report while its node is parked."""
    from chip_run import STARTED

    from chip import flashed
    from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
    from hubodo.emulator.interpreters.rp2040.image import find_image
    from hubodo.emulator.interpreters.rp2040.pico import PicoSettings
    from hubodo.emulator.motion import StillMotion
    from hubodo.emulator.virtual_node import VirtualNode

    image = find_image(None, None)
    pico = PicoSettings(image.firmware, image.bootrom)
    busy_s = []
    with tempfile.TemporaryDirectory() as scratch:
        firmware = Path(scratch) / "flash"
        flashed(firmware, pico)
        # The node is parked after 7 s; two reports later nothing else has been computed.
        for seconds in (7.0, 7.0 + 2 * REPORT_INTERVAL_S):
            node = VirtualNode(
                StillMotion(),
                Flash(firmware, {"park_after_s": 1, "pins": {"wake": 6}}),
                sensors=SensorBoard(chip, interrupt_pin=6),
                board=BoardSettings(interpreter="rp2040", pico=replace(pico, meter_from=STARTED)),
                clock=Clock("stepped", run_for=seconds),
                host=Host("memory"),
                seed=seed,
            )
            with node:
                node.wait(60 + 30 * seconds)
                meter = node.meter()
            busy_s.append((meter["total_us"] - meter["idle_us"]) * 1e-6)
    return (busy_s[1] - busy_s[0]) / 2


def life_table(shares: dict[str, float]) -> Table:
    """Return the battery life by settings and cell, with LSM6DS33, LIS3MDL and nRF24L01+."""
    shown = Table("settings", "awake", "power", *CELLS)
    for name, share in shares.items():
        power = node_milliwatts(share, IMUS[0], *(() if name == "parked" else (MAGNETOMETER, RADIO)))
        shown.add_row(
            name, f"{share:.1%}", f"{power:.0f} mW", *(f"{hours(c, power):.0f} h" for c in CELLS.values())
        )
    if {"default", "parked"} <= set(shares):
        driving = node_milliwatts(shares["default"], IMUS[0], MAGNETOMETER, RADIO)
        asleep = parked_milliwatts(PARKED_BOARDS[0])
        for name, parked in (
            ("2 h driving a day, parked at 26 Hz", node_milliwatts(shares["parked"], IMUS[0])),
            ("2 h driving a day, parked asleep", asleep),
        ):
            power = daily_mean(driving, parked)
            shown.add_row(
                name, "", f"{power:.0f} mW", *(f"{hours(c, power) / 24:.1f} days" for c in CELLS.values())
            )
    return shown


def parked_table() -> Table:
    """Return the battery life of a parked node with an LSM6DSO, by board."""
    shown = Table("parked", "ends its sleep", "power", *CELLS)
    for board in PARKED_BOARDS:
        power = parked_milliwatts(board)
        lives = (f"{hours(c, power) / 24:.0f} days" for c in CELLS.values())
        ends = f"read every {1 / board.polls_hz:g} s" if board.polls_hz else "wire from INT1"
        shown.add_row(board.asleep.name, ends, f"{power:.1f} mW", *lives)
    return shown


def load_table() -> Table:
    """Return the currents, at the voltage of their source and as power of the cell."""
    shown = Table("load", "current", "power at the cell", "source")
    boards = (load for board in PARKED_BOARDS[1:] for load in (board.asleep, board.awake))
    for load in (AWAKE, WAITING, ASLEEP, *boards, *IMUS, IMU_ASLEEP, MAGNETOMETER, RADIO):
        current = f"{load.milliamps:g} mA at {load.volts:g} V"
        shown.add_row(load.name, current, f"{milliwatts(load):.2f} mW", load.source)
    return shown


def main(argv=None):
    """Print the tables; return 1 if an emulated Pico is missing."""
    parser = argparse.ArgumentParser(
        prog="power.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=6.0, help="emulated, of each run (default: 6)")
    parser.add_argument("--seed", type=int, default=1, help="of the chip's rate (default: 1)")
    parser.add_argument("--settings", default=",".join(SETTINGS), help=f"some of: {', '.join(SETTINGS)}")
    parser.add_argument("--awake", type=float, help="share of time awake, instead of emulating a Pico")
    parser.add_argument("--report", action="store_true", help="measure a report of a parked node alone")
    args = parser.parse_args(argv)
    if args.report:
        print(
            f"a report of a parked node with an LSM6DSO: {1000 * measure_report('lsm6dso', args.seed):.1f} ms"
        )
        return 0
    names = args.settings.split(",")
    if unknown := sorted(set(names) - set(SETTINGS)):
        parser.error(f"--settings {unknown[0]}: none of {', '.join(SETTINGS)}")
    if args.awake is not None:
        shares = dict.fromkeys(names, args.awake)
    else:
        from hubodo.emulator.interpreters.rp2040.image import ImageMissing

        try:
            shares = measure(names, args.seconds, args.seed)
        except ImageMissing as missing:
            print(missing, file=sys.stderr)
            return 1
    console = Console(width=max(Console().width, 130))
    console.print(load_table())
    console.print(life_table(shares))
    console.print(parked_table())
    return 0


if __name__ == "__main__":
    sys.exit(main())
