"""Run a virtual node at standstill on a serial port until Ctrl-C: `python -m hubodo.emulator`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
from hubodo.emulator.chips.catalogue import IMU_CHIPS
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.errors import HubodoError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a node at standstill until Ctrl-C, and print its port."""
    parser = argparse.ArgumentParser(
        prog="python -m hubodo.emulator",
        description="Run firmware on a virtual board at standstill.",
    )
    parser.add_argument(
        "firmware", type=Path, nargs="?", help="directory with main.py; empty flash by default"
    )
    parser.add_argument("--link", type=Path, metavar="PATH", help="symbolic link to the terminal")
    parser.add_argument("--node-id", type=int, default=1)
    parser.add_argument(
        "--rate", type=int, default=208, metavar="HZ", help="rate_hz of the node (default 208)"
    )
    parser.add_argument("--chip", choices=sorted(kind.chip_name for kind in IMU_CHIPS), default="lsm6ds33")
    parser.add_argument("--spin", type=float, default=0.0, metavar="RAD_S", help="rate about z (default 0)")
    parser.add_argument("--interpreter", choices=("micropython", "cpython", "rp2040"), default="micropython")
    given = parser.parse_args(arguments)
    config = {"node_id": given.node_id, "rate_hz": given.rate} if given.firmware is not None else None
    try:
        with VirtualNode(
            StillMotion(rate=(0.0, 0.0, given.spin)),
            Flash(given.firmware, config),
            sensors=SensorBoard(given.chip),
            board=BoardSettings(interpreter=given.interpreter),
            clock=Clock("paced" if given.interpreter == "rp2040" else "real"),
            host=Host(path=given.link),
        ) as node:
            print(node.port, flush=True)
            node.wait()
    except HubodoError as failure:
        print(failure, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
