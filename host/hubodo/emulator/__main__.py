"""`python -m hubodo.emulator`: a virtual node that lies still, on a serial port, until Ctrl-C."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from hubodo.emulator.board.process import IMUS
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.errors import HubodoError


def main(arguments: Sequence[str] | None = None) -> int:
    """`python -m hubodo.emulator`: a node that lies still, until Ctrl-C; prints its port."""
    parser = argparse.ArgumentParser(
        prog="python -m hubodo.emulator",
        description="Run firmware on a virtual board that lies still.",
    )
    parser.add_argument("firmware", type=Path, nargs="?", help="directory with main.py; none = empty flash")
    parser.add_argument(
        "--link", type=Path, metavar="PATH", help="where to keep a symbolic link on the terminal"
    )
    parser.add_argument("--node-id", type=int, default=1)
    parser.add_argument(
        "--rate", type=int, default=208, metavar="HZ", help="rate_hz of the node (default 208)"
    )
    parser.add_argument("--chip", choices=sorted(IMUS), default="lsm6ds33")
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
