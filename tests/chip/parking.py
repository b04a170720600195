"""Print how many samples a parked node loses when it falls asleep and wakes up, on the virtual board.

    python tests/chip/parking.py [--cycles 50] [--seed 1] [--chips lsm6dso,lsm6ds33] [--model pico]

Each cycle is 9 s: a drive of 1.5 s, 1 s at standstill until the node sleeps, and the sleep until the next.
Lost: samples of the chip that the host did not get, but for those of the sleep more than 4 s before its end.
"""

import argparse
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
_CYCLES_A_RUN = 10
"""A long motion needs much memory, so a new node is started after this many cycles."""


def main(argv=None):
    """Print a row for each chip, with INT1 wired and not; return 1 if a sample was lost."""
    from parking_runs import WAKE_PINS, park

    parser = argparse.ArgumentParser(
        prog="parking.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cycles", type=int, default=50, help="of each row (default: 50)")
    parser.add_argument("--seed", type=int, default=1, help="of the motion (default: 1)")
    parser.add_argument("--chips", default="lsm6dso,lsm6ds33", help="(default: %(default)s)")
    parser.add_argument("--model", default="pico", choices=WAKE_PINS, help="board (default: %(default)s)")
    args = parser.parse_args(argv)
    shown = Table(
        "chip", "INT1", "wake-ups", "samples sent", "lost", "motion to full rate, median and longest"
    )
    lost = 0
    for chip in args.chips.split(","):
        for wired in (True, False):
            sizes = [min(_CYCLES_A_RUN, args.cycles - k) for k in range(0, args.cycles, _CYCLES_A_RUN)]
            runs = [
                park(n, model=args.model, chip=chip, wired=wired, seed=args.seed + k)
                for k, n in enumerate(sizes)
            ]
            delays = sorted(1000 * delay for result in runs for delay in result.delays)
            lost += sum(result.lost for result in runs)
            shown.add_row(
                chip,
                "wired" if wired else "not wired",
                str(len(delays)),
                f"{sum(result.sent for result in runs):,}",
                str(sum(result.lost for result in runs)),
                f"{delays[len(delays) // 2]:.0f} ms, {delays[-1]:.0f} ms",
            )
    Console(width=max(Console().width, 110)).print(shown)
    return int(lost > 0)


if __name__ == "__main__":
    sys.exit(main())
