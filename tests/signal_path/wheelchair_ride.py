"""A real ride on two wheels through chip registers, firmware, serial ports, recorder and log, run once."""

import gzip
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hubodo.demo.attached_node import AttachedNode
from hubodo.emulator.board.settings import Clock, Flash, Host, SensorBoard
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.sampling import ChipSamples
from hubodo.emulator.motion import RecordedMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.flash.image import build_image, firmware_folder
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.vehicle import load_vehicle
from vehicles import vehicle_toml

WHEELS = {"left": 1, "right": 2}
ODR_ERROR = {"left": 0.031, "right": -0.017}
RIDE = 15.0  # s of the recording
START = 2.0  # chip time at the start of the ride, s; the node has booted by then
VEHICLE = vehicle_toml()


def read_csv(path: Path) -> dict[str, np.ndarray]:
    opener = gzip.open if path.suffix == ".gz" else open
    with opener(path, "rt") as stream:
        names = stream.readline().strip().split(",")
    data = np.loadtxt(path, delimiter=",", skiprows=1)
    return dict(zip(names, data.T, strict=True))


def recorded_motion(path: Path) -> RecordedMotion:
    ride = read_csv(path)
    gyro = np.column_stack([ride["gx"], ride["gy"], ride["gz"]])
    accel = np.column_stack([ride["ax"], ride["ay"], ride["az"]])
    return RecordedMotion(ride["t"], gyro, accel, temperature_c=ride["temperature"], start=START)


@dataclass(frozen=True)
class Ride:
    """Results of one run through the complete signal path."""

    folder: Path
    truth: dict[str, ChipSamples]
    result: dict
    stats: dict[str, dict]


def drive(data: Path, folder: Path) -> Ride:
    """Run the complete signal path in virtual time; data: samples of the real recording."""
    image = folder / "image"
    for name, content in build_image(firmware_folder(), None).items():
        (image / name).parent.mkdir(parents=True, exist_ok=True)
        (image / name).write_bytes(content)
    (folder / "vehicle.toml").write_text(VEHICLE)
    nodes = {
        name: VirtualNode(
            recorded_motion(data / f"{name}.csv.gz"),
            Flash(image, {"node_id": number, "rate_hz": 416}),
            sensors=SensorBoard(specimen=Specimen(odr_error=ODR_ERROR[name])),
            clock=Clock("lockstep"),
            host=Host(path=folder / f"tty-{name}"),
            seed=number,
        )
        for name, number in WHEELS.items()
    }
    with ExitStack() as stack:
        computer = VirtualComputer()
        for node in nodes.values():
            computer.plug_in(AttachedNode(stack.enter_context(node), computer))
        ports = tuple(f"{name}={node.port}" for name, node in nodes.items())
        vehicle = load_vehicle(folder / "vehicle.toml")
        config = RecordConfig(ports=ports, duration=START + RIDE + 2.0)
        result = record(config, folder / "ride.mcap", vehicle=vehicle, computer=computer)
        truth = {name: node.chip.truth() for name, node in nodes.items()}
        stats = {name: node.stats for name, node in nodes.items()}
    return Ride(folder, truth, result.as_json(), stats)
