"""Print what Bluetooth carries of two nodes with keys, by connection interval, MTU, PHY and loss.

    python tests/chip/ble.py [--seconds 15] [--seed 1]

The firmware runs on virtual boards (a Pico W and an ESP32), both stacks are those of bumble, and the
air is `emulator/chips/ble_link.py`. Capacity: what gets through of a node at 1660 Hz, which has 25 kB/s.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from ble_rides import SETTLED_S, ride
from hubodo.emulator.chips.ble_link import BleConditions

RATE_HZ, SATURATING_HZ = 416, 1660
CASES = (
    # interval in ms, MTU, payload of the link layer, PHY, loss
    (7.5, 247, 251, 1, 0.0),
    (15, 247, 251, 1, 0.0),
    (15, 185, 251, 1, 0.0),
    (30, 247, 251, 1, 0.0),
    (30, 247, 251, 2, 0.0),
    (30, 247, 27, 1, 0.0),
    (30, 185, 251, 1, 0.0),
    (30, 64, 251, 1, 0.0),
    (50, 247, 251, 1, 0.0),
    (50, 185, 251, 1, 0.0),
    (50, 247, 27, 1, 0.0),
    (50, 247, 251, 1, 0.05),
    (50, 247, 251, 1, 0.1),
    (100, 247, 251, 1, 0.0),
)


def main() -> int:
    """Run all cases and print the table; return 1 if a frame was lost at 416 Hz."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=15.0, help="duration of each run (default: 15)")
    parser.add_argument("--seed", type=int, default=1, help="seed of losses (default: 1)")
    args = parser.parse_args()
    table = Table(
        *("interval", "MTU", "link layer", "PHY", "loss", f"lost at {RATE_HZ} Hz", "delay, median and 99 %"),
        *("per node", "capacity per node"),
        title=f"two nodes, {args.seconds:g} s each, seed {args.seed}",
    )
    lossless = True
    for interval_ms, mtu, piece, phy, loss in CASES:
        conditions = BleConditions(interval=interval_ms / 1e3, piece_bytes=piece, phy=phy, loss=loss)
        run = ride(conditions, mtu=mtu, rate_hz=RATE_HZ, seconds=args.seconds, seed=args.seed)
        full = ride(conditions, mtu=mtu, rate_hz=SATURATING_HZ, seconds=args.seconds, seed=args.seed)
        delays = np.concatenate([stream.delays(SETTLED_S) for stream in run.streams.values()])
        received = [stream.bytes_per_s(SETTLED_S, args.seconds) for stream in run.streams.values()]
        carried = [stream.bytes_per_s(SETTLED_S, args.seconds) for stream in full.streams.values()]
        frames = sum(len(stream.after(SETTLED_S)) for stream in run.streams.values())
        lost = sum(run.lost(k) for k in run.streams)
        lossless &= not lost
        table.add_row(
            *(f"{interval_ms:g} ms", str(mtu), f"{piece} B", f"{phy} Mb/s", f"{loss:.0%}"),
            f"{lost} of {frames + lost} frames",
            f"{np.median(delays) * 1e3:.0f}, {np.quantile(delays, 0.99) * 1e3:.0f} ms" if len(delays) else "",
            *(f"{max(received) / 1e3:.1f} kB/s", f"{min(carried) / 1e3:.1f} kB/s"),
        )
    Console(width=140).print(table)
    return 0 if lossless else 1


if __name__ == "__main__":
    sys.exit(main())
