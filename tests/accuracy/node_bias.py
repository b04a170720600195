"""Effect of the node's own bias estimate as a prior of the odometry: none, floor, own sigma.

    python tests/accuracy/node_bias.py [SEEDS [FIRST_SEED]]

Position error (rms over the seeds) 10 s after the start and at the end of drives of 60 m, with standstills of
0 to 8 s before, by one wheel and by two. The simulator of the drives shares no code with the filter.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from generators import wheel_drives
from hubodo.fuse.wheel import config
from hubodo.fuse.wheel_odometry import compute_wheel_odometry
from hubodo.recording import BIAS_FILTER_COLUMNS, Recording, Table
from hubodo.vehicle import NodeMount, Vehicle
from hubowire.messages import FilterState

COLUMNS = ("t", "gx", "gy", "gz", "ax", "ay", "az")
LEFT, RIGHT = NodeMount("left", "left"), NodeMount("right", "right")
VEHICLES = {
    "one wheel": Vehicle(0.15, 0.5, {"left": LEFT}),
    "two wheels": Vehicle(0.15, 0.5, {"left": LEFT, "right": RIGHT}),
}
FIRST_SEED, NODE_SIGMA = 200, 2e-4  # rad/s: 1 sigma of an initialisation over 2000 samples, with its drift
FLOOR = config._MIN_CALIBRATION_SIGMA["gyro_bias"]
PRIORS = {"none": None, "with the floor": FLOOR, "with its own sigma": NODE_SIGMA}


def filter_table(bias):
    """Return the `Filter` table of a node that estimated this bias (x, y, z), rad/s."""
    table = {name: np.zeros(2) for name in BIAS_FILTER_COLUMNS}
    table["t"][:], table["state"][:] = (0.0, 0.2), FilterState.TRACKING
    for axis, value in zip("xyz", bias, strict=True):
        table[f"bias_{axis}"][:], table[f"sigma_{axis}"][:] = value, NODE_SIGMA
    return Table(table)


def errors(vehicle, standstill, seed):
    """Return for each prior the position error, m, 10 s after the start and at the end."""
    rng = np.random.default_rng(seed)
    drive = wheel_drives.drive(
        wheel_drives.loop(rng, length=60.0, standstill_s=standstill), rng, facing={"right": "right"}
    )
    nodes, filters = {}, {}
    for name in vehicle.nodes:
        node = drive.nodes[name]
        nodes[name] = Table(dict(zip(COLUMNS, [node.t, *node.gyro.T, *node.accel.T], strict=True)))
        truth = np.array([node.truth[f"bias_{axis}"] for axis in "xyz"])
        filters[name] = filter_table(truth + rng.normal(0.0, NODE_SIGMA, 3))
    result = []
    for floor in PRIORS.values():
        config._MIN_CALIBRATION_SIGMA["gyro_bias"] = floor or FLOOR
        recording = Recording(nodes, bias_filters={} if floor is None else filters)
        track = compute_wheel_odometry(recording, vehicle, log="drive").track
        x, y = (np.interp(drive.t, track.t, values) for values in (track.x, track.y))
        position_errors = np.hypot(x - drive.x, y - drive.y)
        result.append((position_errors[np.searchsorted(drive.t, standstill + 10.0)], position_errors[-1]))
    config._MIN_CALIBRATION_SIGMA["gyro_bias"] = FLOOR
    return result


def main():
    arguments = [int(argument) for argument in sys.argv[1:]]
    count, first_seed = (*arguments, *(16, FIRST_SEED)[len(arguments) :])
    seeds = range(first_seed, first_seed + count)
    print(
        f"seeds {seeds.start} to {seeds.stop - 1}; position error, rms, cm: 10 s after the start / at the end"
    )
    print(f"{'':12}{'standstill':>12}" + "".join(f"{name:>22}" for name in PRIORS))
    for name, vehicle in VEHICLES.items():
        for standstill in (0.0, 0.5, 2.0, 8.0):
            rms = np.sqrt(np.mean(np.square([errors(vehicle, standstill, seed) for seed in seeds]), axis=0))
            cells = "".join(f"{100 * start:>13.1f} / {100 * end:6.1f}" for start, end in rms)
            print(f"{name:12}{standstill:10.1f} s{cells}", flush=True)


if __name__ == "__main__":
    main()
