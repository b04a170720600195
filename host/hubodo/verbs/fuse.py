"""`hubodo fuse`: estimate the track of a vehicle from a log, with its uncertainty."""

import argparse
from pathlib import Path

from hubodo.calibration.file import hash_source, read_calibration
from hubodo.fuse.fused_recording import FusedRecording, check_no_results, write_results
from hubodo.fuse.fusion import fuse_recording, parse_smoothing_lag
from hubodo.fuse.wheel_odometry import METHODS
from hubodo.log.any_log import read_log
from hubodo.log.roles import NODES_ROLE
from hubodo.vehicle import load_vehicle
from hubodo.verbs.effect_options import add_effects_option, register_effects
from hubodo.verbs.log_options import (
    LOG_HELP,
    VEHICLE_HELP,
    add_log_options,
    check_node_names,
    stated_input_format,
    stored_vehicle,
)
from hubodo.verbs.numbers import bounded_number

EXAMPLE = """hubodo fuse drive.mcap -o out/                        # with the vehicle that the log carries
  hubodo fuse drive.mcap --vehicle vehicle.toml -o out/"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo fuse`."""
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    add_log_options(parser)
    parser.add_argument(
        "--vehicle",
        type=Path,
        metavar="TOML",
        help=f"{VEHICLE_HELP}; default: the vehicle that the log carries",
    )
    parser.add_argument("--calibration", type=Path, metavar="TOML", help="from `hubodo calibrate`")
    add_effects_option(parser)
    parser.add_argument(
        "--nodes", metavar="NAMES", help="use only these wheel nodes, separated by commas, such as left"
    )
    parser.add_argument("--method", choices=METHODS, default="filter", help="default: filter")
    parser.add_argument(
        "--smooth",
        nargs="?",
        const="full",
        metavar="LAG_S",
        help="smooth each pose with the data up to LAG_S seconds after it, or with the whole log (full, the "
        "default without LAG_S); without --smooth the forward filter is used",
    )
    parser.add_argument("--no-graph", action="store_true", help="do not use GNSS and headings of the log")
    parser.add_argument(
        "--antenna",
        nargs=2,
        type=bounded_number(),
        metavar=("X", "Y"),
        help="GNSS antenna, m forward and left of the midpoint of the axle (overrides [vehicle] antenna)",
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="OUT", help="folder for the result"
    )
    parser.add_argument("--force", action="store_true", help="replace existing results")


def run(args: argparse.Namespace) -> FusedRecording:
    """Estimate the track and write track.csv and fuse.json.

    Returns
    -------
    FusedRecording
        The track and the folder that it was written to.

    Raises
    ------
    InputError
        If options contradict each other, results exist, or the log holds no node of the vehicle.
    """
    register_effects(args)
    vehicle = load_vehicle(args.vehicle) if args.vehicle else stored_vehicle(args.log)
    calibration = read_calibration(args.calibration) if args.calibration else None
    if not args.force:
        check_no_results(args.output)
    lag = parse_smoothing_lag(args.smooth, args.method, "--smooth", "; put LOG before --smooth")
    needed = (NODES_ROLE, "wheels") if args.no_graph else (NODES_ROLE, "wheels", "gnss")
    recording = read_log(args.log, input_format=stated_input_format(args, vehicle, needed=needed))
    check_node_names(vehicle, recording, str(args.vehicle or args.log))
    calibration_source = None
    if args.calibration:
        calibration_source = {"file": str(args.calibration), "sha256": hash_source(args.calibration)}
    fused = fuse_recording(
        recording,
        vehicle,
        log=str(args.log),
        method=args.method,
        nodes=args.nodes.split(",") if args.nodes else None,
        calibration=calibration,
        calibration_from=calibration_source,
        lag=lag,
        graph=not args.no_graph,
        antenna=tuple(args.antenna) if args.antenna else None,
    )
    return write_results(fused, args.output)
