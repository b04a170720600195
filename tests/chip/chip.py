"""Measure the firmware on an emulated Pico: flashed onto an empty board, run with each configuration.

    python tests/chip/chip.py [--seconds 6] [--settings default,416] [--seed 1] [--profile] [--json]

The board runs the MicroPython of real ones; its time is counted in processor cycles, except for the cost of a
miss of the flash cache, which is an estimate (--miss). CPU: without waits and I2C transfers.
"""

import argparse
import dataclasses
import json
import os
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hubodo.cli import main as hubodo
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash
from hubodo.emulator.interpreters.rp2040.image import ImageMissing, default_image_folder, find_image
from hubodo.emulator.interpreters.rp2040.pico import PicoSettings
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubowire import messages as m

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import estimator_times
from chip_run import STARTED, run_chip

SETTINGS = {
    "default": {},
    "104": {"rate_hz": 104, "fifo": True},
    "208": {"rate_hz": 208, "fifo": True},
    "416": {"rate_hz": 416},
    "833": {"rate_hz": 833},
    "1660": {"rate_hz": 1660},
    "104 polled": {"rate_hz": 104, "fifo": False},
    "208 polled": {"rate_hz": 208, "fifo": False},
}
# Estimators that take more processor time; only run when named.
LARGE = {
    "gravity": {"rate_hz": 208, "fifo": True, "bias_kind": int(m.BiasKind.GRAVITY)},
    "rls": {"rate_hz": 208, "fifo": True, "filter_kind": int(m.FilterKind.RLS)},
}
# Other chips, by the name of the emulated one; only run when named.
CHIPS = {
    "lsm6dso": {},
    "lsm6dso 833": {"rate_hz": 833},
    "lsm6dsv": {},
    "lsm6dsv 960": {"rate_hz": 960},
    "icm42688 1000": {"rate_hz": 1000},
    "icm20948 225": {"rate_hz": 225},
    "mpu9250 200": {"rate_hz": 200},
    "bmi088": {"rate_hz": 400},
    "icm42688 spi": {"rate_hz": 1000, "pins": {"imu_csn": 13}},
    "icm42688 spi 2000": {"rate_hz": 2000, "pins": {"imu_csn": 13}},
}
PARALLEL_RUNS = 2


def flashed(folder, pico):
    """Put the files of `hubodo flash` onto an empty board, in `folder`; return the duration in s."""
    began = time.monotonic()
    with VirtualNode(
        StillMotion(),
        Flash(folder=folder),
        board=BoardSettings(interpreter="rp2040", pico=pico),
        clock=Clock("paced"),
    ) as board:
        with redirect_stdout(StringIO()):
            code = hubodo(["flash", board.port, "--json"])
        if code != 0:
            sys.exit("the emulated board could not be flashed; its message stands above")
        board.flash  # noqa: B018  looks at it while the board is on
    return time.monotonic() - began


def parse(argv):
    parser = argparse.ArgumentParser(
        prog="chip.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=6.0, help="emulated, of each run (default: 6)")
    parser.add_argument("--seed", type=int, default=1, help="of the chip's rate (default: 1)")
    names = ", ".join([*SETTINGS, *LARGE, *CHIPS])
    parser.add_argument("--settings", default=",".join(SETTINGS), help=f"some of: {names}")
    parser.add_argument(
        "--image", type=Path, help=f".uf2 or .bin, or a folder (default: {default_image_folder()})"
    )
    parser.add_argument("--bootrom", type=Path, help="default: beside the image")
    parser.add_argument("--vm-in-sram", action="store_true", help="the image with MicroPython's loop in RAM")
    parser.add_argument("--miss", type=int, default=50, help="cycles of a cache miss (default: 50)")
    parser.add_argument("--profile", action="store_true", help="µs per second of each Python function too")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    args = parser.parse_args(argv)
    args.settings = [name.strip() for name in args.settings.split(",")]
    unknown = [name for name in args.settings if name not in SETTINGS | LARGE | CHIPS]
    if unknown:
        parser.error(f"--settings {unknown[0]}: use some of {names}")
    if args.seconds <= STARTED:
        parser.error(f"--seconds {args.seconds:g}: counting begins {STARTED:g} s after power-on")
    return args


def variant(image):
    """Return the image beside `image` whose interpreter is in RAM."""
    return image.with_name(f"{image.stem}-vm-in-sram{image.suffix}")


def main(argv=None):
    args = parse(argv)
    try:
        image = find_image(args.image, args.bootrom)
        if args.vm_in_sram:
            image = find_image(variant(image.firmware), image.bootrom)
    except ImageMissing as missing:
        print(missing, file=sys.stderr)
        return 1 if os.environ.get("CI") or args.image is not None or args.vm_in_sram else 0
    pico = PicoSettings(image.firmware, image.bootrom, args.miss, profile=args.profile)
    note = Console(stderr=True)
    with tempfile.TemporaryDirectory() as scratch, note.status("flashing an empty board") as status:
        firmware = Path(scratch) / "flash"
        took = flashed(firmware, pico)

        def one(name):
            config = (SETTINGS | LARGE | CHIPS)[name]
            chip = name.split()[0] if name in CHIPS else "lsm6ds33"
            run = run_chip(name, config, firmware, args.seconds, seed=args.seed, pico=pico, chip=chip)
            status.update(f"{name} is done, at {run.speed:.2f} of real time")
            return run

        status.update(f"{len(args.settings)} runs of {args.seconds:g} emulated seconds")
        with ThreadPoolExecutor(PARALLEL_RUNS) as pool:
            runs = list(pool.map(one, args.settings))
        times = estimator_times.estimator_times(firmware, Path(scratch), pico)
    if args.json:
        rows = {"runs": runs, "estimators": times}
        print(json.dumps({name: list(map(dataclasses.asdict, of)) for name, of in rows.items()}, indent=1))
        return 0
    console = Console(width=max(Console().width, 150))
    console.print(table(runs, f"{image.firmware.stem}, {args.miss} cycles a miss, seed {args.seed}"))
    console.print(
        f"flashed in {took:.0f} s; emulated at {min(r.speed for r in runs):.2f} of real time or more"
    )
    console.print(estimator_times.table(times))
    if args.profile:
        for run in runs:
            console.print(functions(run))
    return 0


def table(runs, title):
    heads = (
        "settings",
        "samples",
        "lost",
        "waiting\nat the end",
        "burst gap",
        "CPU per\nsample",
        "CPU\nleft",
        "gc_alloc\nper s",
    )
    shown = Table(*heads, "stamp error\nfirst second", "stamp error\nthen", "first\nHello", title=title)
    for run in runs:
        gap = "-" if run.burst_gap_ms is None else f"{run.burst_gap_ms:.1f} ms, {run.fifo_share:.1%} of FIFO"
        shown.add_row(
            run.name,
            str(run.samples),
            str(run.lost),
            str(run.waiting),
            gap,
            f"{run.cpu_us:.0f} µs",
            f"{run.cpu_left:.1%}",
            f"{run.allocations:.0f}",
            *(_stamps(span) for span in (run.begin_us, run.later_us)),
            "-" if run.hello_s is None else f"{run.hello_s:.3f} s",
        )
    return shown


def _stamps(span):
    return "-" if span is None else f"{span[0] / 1e3:+.2f} to {span[1] / 1e3:+.2f} ms"


def functions(run):
    heads = ("own", "with callees", "calls", "each, own", "frame", "function")
    shown = Table(*heads, title=f"{run.name}: µs per second of the loop")
    for f in run.functions:
        each = f"{f['own_us'] / f['calls']:.1f} µs" if f["calls"] else "-"
        shown.add_row(
            f"{f['own_us']:.0f}",
            f"{f['all_us']:.0f}",
            f"{f['calls']:.1f}",
            each,
            "heap" if f["heap"] else "",
            escape(f["name"]),
        )
    shown.caption = "native code has no names: an object's address stands for each of its functions"
    return shown


if __name__ == "__main__":
    sys.exit(main())
