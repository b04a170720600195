"""Arguments of `hubodo simulate`, and the check that they do not contradict each other."""

import argparse
from pathlib import Path

from hubodo.demo.simulated_drive import add_board_arguments
from hubodo.errors import InputError
from hubodo.model import experiments
from hubodo.model.model_file import Model
from hubodo.verbs.effect_options import add_effects_option
from hubodo.verbs.log_options import add_topic_option
from hubodo.verbs.numbers import bounded_number, latitude, seed
from hubodo.verbs.outputs import add_force_option
from hubowire.messages import NODE_IDS

DRIVES = (*experiments.DRIVES, "reference", "gnss")
_MIN_DURATION_S, _MAX_DURATION_S = 5.0, 36000.0
_RATE_BOUNDS_HZ = (1.0, 10000.0)
_FILE_SUFFIXES = (".csv", ".txt", ".bag", ".db3")
_VIRTUAL_NODE_RATES_HZ = (52, 104, 208, 416)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo simulate`."""
    parser.add_argument(
        "model", type=Path, metavar="MODEL.toml", help="model file: vehicle, noise, nodes, effects"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="OUT",
        help="log to write (.mcap), or a folder for CSV files",
    )
    add_force_option(parser, "output")
    parser.add_argument(
        "--drive", choices=DRIVES, default="random", help="drive or bench test (default: random)"
    )
    parser.add_argument(
        "--from",
        dest="source",
        type=Path,
        metavar="LOG",
        help="log or CSV folder for --drive reference and gnss",
    )
    add_topic_option(parser)
    parser.add_argument(
        "--duration",
        type=bounded_number(_MIN_DURATION_S, _MAX_DURATION_S),
        default=120.0,
        help="duration, s (default: 120)",
    )
    parser.add_argument(
        "--rate",
        type=bounded_number(*_RATE_BOUNDS_HZ),
        help="sample rate, Hz (default: 200; with --virtual-node 416)",
    )
    parser.add_argument(
        "--reference-rate",
        type=bounded_number(*_RATE_BOUNDS_HZ),
        default=50.0,
        help="sample rate of the reference, Hz (default: 50)",
    )
    parser.add_argument("--seed", type=seed, default=1, help="seed of drive and noise (default: 1)")
    _add_environment_arguments(parser)
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="TOML",
        help="calibration file whose errors are added to the nodes",
    )
    add_effects_option(parser)
    _add_bench_arguments(parser)
    parser.add_argument("--virtual-node", action="store_true", help="run the firmware on virtual boards")
    add_board_arguments(parser, " of --virtual-node")


def _add_environment_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for temperature and supply voltage."""
    parser.add_argument(
        "--temperature",
        type=bounded_number(-273.0, 1000.0),
        nargs="+",
        metavar="DEG_C",
        help="one temperature, or the first and the last with a linear change",
    )
    parser.add_argument(
        "--settle",
        type=bounded_number(1e-3),
        metavar="S",
        help="with two temperatures: time constant of an exponential warm-up, s",
    )
    parser.add_argument(
        "--supply",
        type=bounded_number(0.0, 1000.0),
        nargs="+",
        metavar="V",
        help="supply of the nodes: one voltage, or the first and the last with a linear change",
    )


def _add_bench_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a turntable and of static poses."""
    parser.add_argument(
        "--latitude-deg", type=latitude, metavar="L", help="latitude; adds Earth rate to a bench test"
    )
    parser.add_argument(
        "--azimuth-deg",
        type=bounded_number(-360.0, 360.0),
        default=0.0,
        metavar="A",
        help="azimuth of table zero, clockwise from north (default: 0)",
    )
    parser.add_argument(
        "--angles-deg",
        type=bounded_number(-3600.0, 3600.0),
        nargs="+",
        default=(0.0, 180.0),
        help="table angles of the stops (default: 0 180)",
    )
    parser.add_argument(
        "--stop",
        type=bounded_number(1.0, _MAX_DURATION_S),
        default=20.0,
        help="duration of a stop, s (default: 20)",
    )
    parser.add_argument(
        "--turn",
        type=bounded_number(0.1, _MAX_DURATION_S),
        default=2.0,
        help="duration of a turn, s (default: 2)",
    )


def check_arguments(args: argparse.Namespace, model: Model) -> None:
    """Raise InputError for options that contradict each other, before anything is computed."""
    if not args.output.absolute().parent.is_dir():
        raise InputError(f"{args.output}: its folder does not exist; create it first")
    if args.output.suffix.lower() in _FILE_SUFFIXES:
        raise InputError(
            f"-o {args.output}: a folder of CSV files is written, one for each node; name a folder, or a log "
            "that ends in .mcap"
        )
    if args.temperature and len(args.temperature) > 2:
        raise InputError("--temperature: give one number, or the first and the last, in °C")
    if args.settle is not None and (not args.temperature or len(args.temperature) < 2):
        raise InputError("--settle goes with two temperatures; give --temperature FIRST LAST")
    if args.supply and len(args.supply) > 2:
        raise InputError("--supply: give one number, or the first and the last, in V")
    needs_log = args.drive in ("reference", "gnss")
    if needs_log != (args.source is not None):
        raise InputError(
            f"--drive {args.drive} needs --from LOG" if needs_log else "--from goes with reference or gnss"
        )
    if args.latitude_deg is not None and args.drive not in ("turntable", "poses"):
        raise InputError(
            "--latitude-deg goes with --drive turntable or poses; in a drive Earth rate is not simulated"
        )
    if args.virtual_node:
        if args.drive in ("turntable", "poses"):
            raise InputError(f"--virtual-node drives; it cannot do {args.drive}; remove one of them")
        if args.supply:
            raise InputError("--virtual-node: its board measures 3.7 V; remove --supply")
        unknown = [name for name in model.vehicle.nodes if name not in NODE_IDS]
        if unknown:
            raise InputError(
                f"--virtual-node: no node is called {unknown[0]!r} in the protocol; use {', '.join(NODE_IDS)}"
            )
        if args.rate is not None and args.rate not in _VIRTUAL_NODE_RATES_HZ:
            rates = ", ".join(map(str, _VIRTUAL_NODE_RATES_HZ))
            raise InputError(f"--rate {args.rate:g}: the sensor of a virtual node supports {rates} Hz")
